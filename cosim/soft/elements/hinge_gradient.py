"""Energy and gradient of many rotational springs, without their Hessian: in groups, one hinge per lane.

With u, e, w, m = u x e and n = e x w as in `hinge`, neither m nor n is brought to unit length:
    theta = atan2(|e| m . w, m . n),
    a = dtheta/dx_i = |e| m / m^2,   b = dtheta/dx_l = -|e| n / n^2,
    dtheta/dx_j = (alpha - 1) a - beta b,   dtheta/dx_k = (beta - 1) b - alpha a,
alpha = u . e / e^2, beta = w . e / e^2.
"""

from __future__ import annotations

import math

import numpy as np

from cosim.base.kernels import inlined
from cosim.soft.elements.arctangent import TURN, full_angle
from cosim.soft.elements.fold_law import fold_law

# Quantity q of lane e is at s[q * LANES + e]: constant distances are what lets loops over lanes vectorise.
LANES = 64
U, E, W, A, B, ALPHA, BETA, ANGLE, MOMENT, TANGENT = (
    LANES * place for place in (0, 3, 6, 9, 12, 15, 16, 17, 18, 19)
)
QUANTITIES = 20


@inlined
def gather(x, hinges, first, lanes, s):  # type: ignore[no-untyped-def]
    """Fill u, e and w of a group; lanes to spare repeat the first hinge."""
    for lane in range(LANES):
        h = first + (lane if lane < lanes else 0)
        i, j, k, m = hinges[h, 0], hinges[h, 1], hinges[h, 2], hinges[h, 3]
        for r in range(3):
            s[U + r * LANES + lane] = x[i, r] - x[j, r]
            s[E + r * LANES + lane] = x[k, r] - x[j, r]
            s[W + r * LANES + lane] = x[k, r] - x[m, r]


@inlined
def differentiate(s):  # type: ignore[no-untyped-def]
    """Fill angle, a, b, alpha and beta of a group."""
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


@inlined
def load(stiffness, rest, theta1, reference, first, lanes, s, angles):  # type: ignore[no-untyped-def]
    """Write a group's unwrapped angles to `angles`, fill its moments and tangents; return the energy."""
    energy = 0.0
    for lane in range(lanes):
        h = first + lane
        angle = s[ANGLE + lane]
        if angle - reference[h] > math.pi:
            angle -= TURN
        elif angle - reference[h] < -math.pi:
            angle += TURN
        angles[h] = angle
        part, s[MOMENT + lane], s[TANGENT + lane] = fold_law(angle, rest[h], stiffness[h], theta1)
        energy += part
    return energy


@inlined
def scatter(hinges, first, lanes, s, force):  # type: ignore[no-untyped-def]
    """Add a group's gradient to force."""
    for lane in range(lanes):
        h = first + lane
        i, j, k, m = hinges[h, 0], hinges[h, 1], hinges[h, 2], hinges[h, 3]
        moment, alpha, beta = s[MOMENT + lane], s[ALPHA + lane], s[BETA + lane]
        for r in range(3):
            a, b = moment * s[A + r * LANES + lane], moment * s[B + r * LANES + lane]
            force[i, r] += a
            force[m, r] += b
            force[j, r] += (alpha - 1.0) * a - beta * b
            force[k, r] += (beta - 1.0) * b - alpha * a


@inlined
def add_hinge_gradients(x, hinges, stiffness, rest, theta1, reference, force, angles):  # type: ignore[no-untyped-def]
    """Add all hinges' gradient to force, write their angles; return the energy as `add_hinges` does.

    A loop of its own: one loop for both, with a branch for the Hessian, takes a fifth longer with it.
    """
    s = np.empty(QUANTITIES * LANES)
    energy = 0.0
    for first in range(0, hinges.shape[0], LANES):
        lanes = min(LANES, hinges.shape[0] - first)
        gather(x, hinges, first, lanes, s)
        differentiate(s)
        energy += load(stiffness, rest, theta1, reference, first, lanes, s, angles)
        scatter(hinges, first, lanes, s, force)
    return energy
