"""The stability ratio of the staggered exchange, and how a soft robot's inertia reacts to the flange.

An implicit soft step reacts to a change dv of the flange's velocity with the wrench -M_a dv / h. The
algorithmic mass M_a never exceeds the whole mass carried rigidly, M_a <= sum_i m_i G_i^T G_i with
G_i = [1, -S(r_i)]. The staggered exchange is stable while the largest eigenvalue of W M_a, the stability
ratio, is below about one (W: flange mobility); `algorithmic_mass` extends the range. The flange's
accelerations a_n are second differences of its positions over h^2. The soft robot's inertia reacts to them
with -M a_n where it steps by implicit Euler, and with -M (9 a_n - 6 a_n-1 + a_n-2) / 4 where it steps by
BDF2, whose difference quotient applied twice is (3 z - 1)^2 / 4 times those second differences.
Source: Causin, Gerbeau and Nobile, CMAME 194 (2005) 4506, for the added-mass limit.
"""

from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.solve.step_scheme import Integrator

IMPLICIT_EULER: Final = (1.0, 0.0, 0.0)
_BDF2: Final = (9.0 / 4.0, -6.0 / 4.0, 1.0 / 4.0)


def reaction_weights(integrator: Integrator) -> tuple[float, ...]:
    """Return the weights s of the last accelerations, last first: the reaction is -M sum_k s_k a_n-k."""
    return _BDF2 if integrator == "bdf2" else IMPLICIT_EULER


def exchange_gain(weights: tuple[float, ...]) -> float:
    """Return the factor by which the limit of mass is smaller than with implicit Euler, one tick late.

    Changes d of the flange's velocity follow d_n+1 = -r sum_k s_k d_n-k, r the mass ratio: stable below
    r = 1 / sum_k |s_k|, which is 1 for implicit Euler and 1/4 for BDF2.

    Args:
        weights: s, of `reaction_weights`.
    """
    return float(np.abs(weights).sum())


def stability_ratio(mobility: Array, algorithmic_mass: Array) -> float:
    """Return the largest eigenvalue of W M_a.

    Args:
        mobility: W (6, 6), symmetric, flange velocity change per impulse.
        algorithmic_mass: M_a (6, 6), symmetric.
    """
    from scipy.linalg import lapack  # imported here because it takes long to load

    values, _, failure = lapack.dsygv(mobility, algorithmic_mass, itype=2, jobz="N")
    if failure == 0:
        return float(values[-1])
    # a mass without extent is not positive definite
    return float(np.linalg.eigvals(mobility @ algorithmic_mass).real.max())
