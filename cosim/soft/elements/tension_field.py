"""Tension field of an isotropic film: what is left of its energy once it may wrinkle as finely as it likes.

With principal Green strains e1 >= e2, thickness t, Young's modulus E, Poisson's ratio nu:
    slack     e1 <= 0:                  psi = 0,
    wrinkled  e1 > 0, e2 + nu e1 <= 0:  psi = E t e1^2 / 2,
    taut      otherwise:                psi = e : C : e / 2, the plain law.
psi is convex with a continuous gradient; its second derivative jumps where the state changes.
A share f of the plain law can stay, f psi_plain + (1 - f) psi: the film's bending resists fine wrinkles.
With f = 0 a slack triangle resists nothing and may collapse, which a hinge beside it cannot bear: where
hinges are, f should be 1e-4 or more.
Source: Pipkin, IMA J. Appl. Math. 36 (1986) 85-99; Steigmann, Proc. R. Soc. A 429 (1990) 141-173.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import device_function

SLACK: Final = 0
WRINKLED: Final = 1
TAUT: Final = 2


@device_function
def tension_field(e11, e22, e12, stiffness, fraction, n, c):  # type: ignore[no-untyped-def]
    """Fill n (3,) and c (3, 3), first and second derivative of the energy density by (E11, E22, 2 E12).

    In the wrinkled state e1 = m + r, m the mean and r the radius of Mohr's circle. Its derivative is a, the
    square of the first principal direction, and the second one w w^T / r turns that direction:
        n = E t e1 a,   c = E t (a a^T + (e1 / r) w w^T).
    There r >= (1 - |nu|) e1 / 2, so nothing is divided by a small number: where e1 = e2 the film is taut
    or slack.

    Args:
        e11, e22, e12: E11, E22, 2 E12.
        stiffness: (3, 3) [N/m], of the plain law.
        fraction: f, 0 to 1.

    Returns:
        Energy density [J/m^2].
    """
    mean = 0.5 * (e11 + e22)
    half = 0.5 * (e11 - e22)
    radius = math.sqrt(half * half + 0.25 * e12 * e12)
    first = mean + radius
    ratio = stiffness[0, 1] / stiffness[0, 0]
    taut = mean - radius + ratio * first > 0.0 and first > 0.0
    weight = 1.0 if taut else fraction
    n[0] = weight * (stiffness[0, 0] * e11 + stiffness[0, 1] * e22)
    n[1] = weight * (stiffness[1, 0] * e11 + stiffness[1, 1] * e22)
    n[2] = weight * stiffness[2, 2] * e12
    for r in range(3):
        for s in range(3):
            c[r, s] = weight * stiffness[r, s]
    density = 0.5 * (e11 * n[0] + e22 * n[1] + e12 * n[2])
    if taut or first <= 0.0:
        return density
    tension = (1.0 - fraction) * stiffness[0, 0] * (1.0 - ratio * ratio)  # E t
    cosine, sine = half / radius, 0.5 * e12 / radius  # of twice the first principal angle
    a0, a1, a2 = 0.5 * (1.0 + cosine), 0.5 * (1.0 - cosine), 0.5 * sine
    w0, w2 = -0.5 * sine, 0.5 * cosine
    turn = tension * first / radius
    n[0] += tension * first * a0
    n[1] += tension * first * a1
    n[2] += tension * first * a2
    c[0, 0] += tension * a0 * a0 + turn * w0 * w0
    c[1, 1] += tension * a1 * a1 + turn * w0 * w0
    c[2, 2] += tension * a2 * a2 + turn * w2 * w2
    c01 = tension * a0 * a1 - turn * w0 * w0
    c02 = tension * a0 * a2 + turn * w0 * w2
    c12 = tension * a1 * a2 - turn * w0 * w2
    c[0, 1] += c01
    c[1, 0] += c01
    c[0, 2] += c02
    c[2, 0] += c02
    c[1, 2] += c12
    c[2, 1] += c12
    return density + 0.5 * tension * first * first


def film_states(strain: Array, poisson_ratio: float) -> IntArray:
    """Return SLACK, WRINKLED or TAUT for each strain.

    Args:
        strain: (m, 3), Green strain as (E11, E22, 2 E12).
        poisson_ratio: nu.

    Returns:
        (m,) states.
    """
    mean, half = 0.5 * (strain[:, 0] + strain[:, 1]), 0.5 * (strain[:, 0] - strain[:, 1])
    radius = np.hypot(half, 0.5 * strain[:, 2])
    first, second = mean + radius, mean - radius
    taut = (first > 0.0) & (second + poisson_ratio * first > 0.0)
    return np.where(taut, TAUT, np.where(first > 0.0, WRINKLED, SLACK))
