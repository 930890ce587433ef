"""Energy and gradient of many rotational springs, without their Hessian: in groups, one hinge per lane.

With u, e, w, m = u x e and n = e x w as in `hinge`, neither m nor n is brought to unit length:
    theta = atan2(|e| m . w, m . n),
    a = dtheta/dx_i = |e| m / m^2,   b = dtheta/dx_l = -|e| n / n^2,
    dtheta/dx_j = (alpha - 1) a - beta b,   dtheta/dx_k = (beta - 1) b - alpha a,
alpha = u . e / e^2, beta = w . e / e^2.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.kernels import IndexTable, Matrix, Vector, device_function
from cosim.soft.elements.element import Remembered

TURN = 2.0 * math.pi
_EIGHTH = math.tan(math.pi / 8.0)


@device_function
def full_angle(sine: float, cosine: float) -> float:
    """Return atan2(sine, cosine) in [0, 2 pi), to 2e-15; NaN where both are zero.

    The ratio is brought to |t| <= tan(pi / 8); there (atan(t) / t - 1) / t^2 is a polynomial in t^2 that
    meets the series at 11 Chebyshev points (5e-18 off in between).
    """
    height, width = abs(sine), abs(cosine)
    steep = height > width
    large = height if steep else width
    small = width if steep else height
    beyond = small > _EIGHTH * large
    t = (small - large if beyond else small) / (small + large if beyond else large)
    z = t * t
    p = 0.03923044778479309 - 0.019175404711104935 * z
    p = p * z - 0.050854078345894844
    p = p * z + 0.05858140904866328
    p = p * z - 0.06664510525508936
    p = p * z + 0.07692183125376892
    p = p * z - 0.0909090457530649
    p = p * z + 0.11111111015187018
    p = p * z - 0.14285714284665682
    p = p * z + 0.19999999999995516
    p = p * z - 0.3333333333333333
    angle = t + t * z * p + (0.25 * math.pi if beyond else 0.0)
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if cosine < 0.0 else angle
    return TURN - angle if sine < 0.0 else angle


CLOSED_FRACTION: Final = 4e-4
"""x_c: below x_c theta1 a fold is closed, its stiffness k (2 / (pi x_c))^2 = 2.5e6 k.

At 1e-2 films passed one another. The folds of the paper's examples stay above 4.5e-4 theta1.
"""
_CLOSED_ARGUMENT = 0.5 * math.pi * (1.0 - CLOSED_FRACTION)
_CLOSED_TANGENT = math.tan(_CLOSED_ARGUMENT)
_CLOSED_STIFFNESS = 1.0 / math.cos(_CLOSED_ARGUMENT) ** 2
_CLOSED_LOGARITHM = math.log(math.cos(_CLOSED_ARGUMENT))


@device_function
def fold_law(angle: float, rest: float, stiffness: float, theta1: float) -> tuple[float, float, float]:
    """Return energy, moment and tangent of one spring, all finite and continuous, also beyond 0 and 2 pi."""
    if theta1 <= 0.0 or theta1 < angle < TURN - theta1:
        return 0.5 * stiffness * (angle - rest) * (angle - rest), stiffness * (angle - rest), stiffness
    # mirror the upper barrier onto the lower one: angle -> 2 pi - angle flips the moment's sign
    sign = 1.0
    if angle > math.pi:
        sign, angle, rest = -1.0, TURN - angle, TURN - rest
    start = theta1 - rest
    scale = 2.0 * theta1 / math.pi
    further = angle - CLOSED_FRACTION * theta1
    if further < 0.0:
        moment = start - scale * _CLOSED_TANGENT
        energy = 0.5 * start * start + start * (angle - further - theta1) - scale * scale * _CLOSED_LOGARITHM
        energy += further * (moment + 0.5 * _CLOSED_STIFFNESS * further)
        moment += _CLOSED_STIFFNESS * further
        return stiffness * energy, sign * stiffness * moment, stiffness * _CLOSED_STIFFNESS
    argument = 0.5 * math.pi * (theta1 - angle) / theta1
    cosine = math.cos(argument)
    moment = stiffness * (start - scale * math.tan(argument))
    energy = stiffness * (0.5 * start * start + start * (angle - theta1) - scale * scale * math.log(cosine))
    return energy, sign * moment, stiffness / (cosine * cosine)


# Quantity q of lane e is at s[q * LANES + e]: constant distances are what lets loops over lanes vectorise.
LANES = 64
U, E, W, A, B, ALPHA, BETA, ANGLE, MOMENT, TANGENT, ENERGY, FORCE = (
    LANES * place for place in (0, 3, 6, 9, 12, 15, 16, 17, 18, 19, 20, 21)
)
QUANTITIES = 33
ROOM = QUANTITIES * LANES


class HingeRows(NamedTuple):
    """Rotational springs, for kernels.

    Args:
        nodes: (h, 4) node indices i, j, k, l.
        stiffness: (h,) [N m/rad].
        rest: (h,) [rad], stress-free angle.
        fold_barrier: theta1 [rad], where the barrier begins; 0 for none.
    """

    nodes: IndexTable
    stiffness: Vector
    rest: Vector
    fold_barrier: float


@device_function
def nodes_of(hinges: IndexTable, h: int) -> tuple[Any, Any, Any, Any]:
    """Return the nodes of a hinge, of a type that needs no test for places counted from the end."""
    i, j, k, m = hinges[h, 0], hinges[h, 1], hinges[h, 2], hinges[h, 3]
    return np.uint64(i), np.uint64(j), np.uint64(k), np.uint64(m)


@device_function
def differentiate(x: Matrix, hinges: IndexTable, first: int, lanes: int, s: Vector) -> None:
    """Fill u, e, w, angle, a, b, alpha and beta of a group; lanes to spare repeat the first hinge."""
    for lane in range(LANES):
        h = first + (lane if lane < lanes else 0)
        i, j, k, m = nodes_of(hinges, h)
        for r in range(3):
            s[U + r * LANES + lane] = x[i, r] - x[j, r]
            s[E + r * LANES + lane] = x[k, r] - x[j, r]
            s[W + r * LANES + lane] = x[k, r] - x[m, r]

    for lane in range(LANES):
        u0, u1, u2 = s[U + lane], s[U + LANES + lane], s[U + 2 * LANES + lane]
        e0, e1, e2 = s[E + lane], s[E + LANES + lane], s[E + 2 * LANES + lane]
        w0, w1, w2 = s[W + lane], s[W + LANES + lane], s[W + 2 * LANES + lane]
        m0, m1, m2 = u1 * e2 - u2 * e1, u2 * e0 - u0 * e2, u0 * e1 - u1 * e0
        n0, n1, n2 = e1 * w2 - e2 * w1, e2 * w0 - e0 * w2, e0 * w1 - e1 * w0
        square = e0 * e0 + e1 * e1 + e2 * e2
        length = math.sqrt(square)
        sine = length * (m0 * w0 + m1 * w1 + m2 * w2)
        s[ANGLE + lane] = full_angle(sine, m0 * n0 + m1 * n1 + m2 * n2)
        a = length / (m0 * m0 + m1 * m1 + m2 * m2)
        b = -length / (n0 * n0 + n1 * n1 + n2 * n2)
        s[A + lane], s[A + LANES + lane], s[A + 2 * LANES + lane] = a * m0, a * m1, a * m2
        s[B + lane], s[B + LANES + lane], s[B + 2 * LANES + lane] = b * n0, b * n1, b * n2
        s[ALPHA + lane] = (u0 * e0 + u1 * e1 + u2 * e2) / square
        s[BETA + lane] = (w0 * e0 + w1 * e1 + w2 * e2) / square


@device_function
def load(springs: HingeRows, angles: Remembered, first: int, lanes: int, s: Vector) -> float:
    """Write a group's unwrapped angles, fill its moments and tangents; return the energy."""
    k, free, theta1 = springs.stiffness[first:], springs.rest[first:], springs.fold_barrier
    before, after = angles.before[first:], angles.now[first:]
    for lane in range(lanes):
        angle = s[ANGLE + lane]
        beyond = angle - before[lane]
        angle = angle - TURN if beyond > math.pi else angle + TURN if beyond < -math.pi else angle
        after[lane] = s[ANGLE + lane] = angle
        off, stiffness = angle - free[lane], k[lane]
        s[ENERGY + lane], s[MOMENT + lane] = 0.5 * stiffness * off * off, stiffness * off
        s[TANGENT + lane] = stiffness
    total = 0.0
    for lane in range(lanes):
        angle = s[ANGLE + lane]
        if not theta1 < angle < TURN - theta1:
            law = fold_law(angle, free[lane], k[lane], theta1)
            s[ENERGY + lane], s[MOMENT + lane], s[TANGENT + lane] = law
        total += s[ENERGY + lane]
    return total


@device_function
def scatter(hinges: IndexTable, first: int, lanes: int, s: Vector, gradient: Matrix) -> None:
    """Add a group to gradient."""
    for r in range(3):
        for lane in range(LANES):
            moment, alpha, beta = s[MOMENT + lane], s[ALPHA + lane], s[BETA + lane]
            a, b = moment * s[A + r * LANES + lane], moment * s[B + r * LANES + lane]
            s[FORCE + 4 * r * LANES + lane], s[FORCE + (4 * r + 1) * LANES + lane] = a, b
            s[FORCE + (4 * r + 2) * LANES + lane] = (alpha - 1.0) * a - beta * b
            s[FORCE + (4 * r + 3) * LANES + lane] = (beta - 1.0) * b - alpha * a
    for lane in range(LANES):
        if lane == lanes:
            break
        i, j, k, m = nodes_of(hinges, first + lane)
        for r in range(3):
            gradient[i, r] += s[FORCE + 4 * r * LANES + lane]
            gradient[m, r] += s[FORCE + (4 * r + 1) * LANES + lane]
            gradient[j, r] += s[FORCE + (4 * r + 2) * LANES + lane]
            gradient[k, r] += s[FORCE + (4 * r + 3) * LANES + lane]
