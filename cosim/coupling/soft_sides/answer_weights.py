"""What an integrator makes of the soft side's mass in an exchange that is one tick late.

The flange's accelerations a_n are second differences of its places over h^2. To them the soft side's inertia
answers with -M a_n where it steps by implicit Euler, with -M (9 a_n - 6 a_n-1 + a_n-2) / 4 where it steps by
BDF2, whose difference quotient taken twice is (3 z - 1)^2 / 4 times those second differences.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.solve.time_scheme import Integrator

IMPLICIT_EULER: Final = (1.0, 0.0, 0.0)
_BDF2: Final = (9.0 / 4.0, -6.0 / 4.0, 1.0 / 4.0)


def answer_weights(integrator: Integrator) -> tuple[float, ...]:
    """Return the weights s of the last accelerations, last first: the answer is -M sum_k s_k a_n-k."""
    return _BDF2 if integrator == "bdf2" else IMPLICIT_EULER


def exchange_gain(weights: tuple[float, ...]) -> float:
    """Return how many times less mass an exchange that is one tick late bears than with implicit Euler.

    Changes d of the flange's velocity follow d_n+1 = -r sum_k s_k d_n-k, r the mass ratio: stable below
    r = 1 / sum_k |s_k|, which is 1 and 1/4.

    Args:
        weights: s, of `answer_weights`.
    """
    return float(np.abs(weights).sum())


def expecting_no_change(weights: tuple[float, ...]) -> Array:
    """Return the weights (k,) of the last accelerations whose sum is that at which the answer stays as it is.

    -M sum_k s_k a_n+1-k is -M sum_k s_k a_n-k where a_n+1 is sum_k (s_k - s_k+1) a_n-k / s_0: the last one
    with implicit Euler.

    Args:
        weights: s, of `answer_weights`.
    """
    return np.asarray((np.array(weights) - np.append(weights[1:], 0.0)) / weights[0])
