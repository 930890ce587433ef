"""Rotational springs on the dihedral angle of interior edges, with an optional fold barrier.

Nodes (i, j, k, l): j-k is the edge, i and l its opposite corners. With u = x_i - x_j, e = x_k - x_j,
w = x_k - x_l, m = u x e, n = e x w the angle is
    theta = atan2(e/|e| . (m x n), m . n)  in [0, 2 pi),   theta = pi where the film is flat,
    energy = k (theta - theta0)^2 / 2  between theta1 and theta2 = 2 pi - theta1.
Beyond them the moment grows as k (theta1 - theta0) - (2 k theta1 / pi) tan(pi (theta1 - theta) / (2 theta1)),
infinite where the two films touch (theta = 0 or 2 pi).
Source: Liu and Paulino, Proc. R. Soc. A 473 (2017) 20170348, equations for theta and the barrier; the
second derivatives are written here in the orthonormal frames of the two triangles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.frames import Array, IntArray
from cosim.kernels import BLOCKS, INDEX_TABLE, MATRIX, REAL, VECTOR, inlined, kernel
from cosim.soft.arctangent import TURN
from cosim.soft.blocks import add_block
from cosim.soft.fold_law import fold_law
from cosim.soft.hinge_gradient import add_hinge_gradients


@inlined
def _frame(x, hinge, v):  # type: ignore[no-untyped-def]
    """Fill v rows: unit edge, unit m, p = e x m, unit n, q = e x n, u, w; return lengths and angle.

    Returns edge length, height of i, height of l, u . edge, w . edge, angle.
    """
    i, j, k, m = hinge[0], hinge[1], hinge[2], hinge[3]
    for r in range(3):
        v[0, r] = x[k, r] - x[j, r]
        v[5, r] = x[i, r] - x[j, r]
        v[6, r] = x[k, r] - x[m, r]
    length = math.sqrt(v[0, 0] ** 2 + v[0, 1] ** 2 + v[0, 2] ** 2)
    for r in range(3):
        v[0, r] /= length
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        v[1, r] = v[5, s] * v[0, t] - v[5, t] * v[0, s]
        v[3, r] = v[0, s] * v[6, t] - v[0, t] * v[6, s]
    height_i = math.sqrt(v[1, 0] ** 2 + v[1, 1] ** 2 + v[1, 2] ** 2)
    height_l = math.sqrt(v[3, 0] ** 2 + v[3, 1] ** 2 + v[3, 2] ** 2)
    for r in range(3):
        v[1, r] /= height_i
        v[3, r] /= height_l
    along_u = along_w = cosine = sine = 0.0
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        v[2, r] = v[0, s] * v[1, t] - v[0, t] * v[1, s]
        v[4, r] = v[0, s] * v[3, t] - v[0, t] * v[3, s]
        along_u += v[5, r] * v[0, r]
        along_w += v[6, r] * v[0, r]
        cosine += v[1, r] * v[3, r]
        sine += v[2, r] * v[3, r]
    # sine = p . n = (e x m) . n = e . (m x n)
    angle = math.atan2(sine, cosine)
    if angle < 0.0:
        angle += TURN
    return length, height_i, height_l, along_u, along_w, angle


@inlined
def _second(v, length, height_i, height_l, along_u, along_w, a, b, h):  # type: ignore[no-untyped-def]
    """Fill h[0..9] = second derivatives of the angle for the pairs ii ji jj ki kj kk li lj lk ll."""
    alpha, beta = along_u / length, along_w / length
    over_i, over_l = 1.0 / height_i, 1.0 / height_l
    for r in range(3):
        for c in range(3):
            pm = (v[2, r] * v[1, c] + v[1, r] * v[2, c]) * over_i * over_i
            qn = (v[4, r] * v[3, c] + v[3, r] * v[4, c]) * over_l * over_l
            a_u = -pm
            a_e = alpha * pm - v[0, r] * v[1, c] * over_i / length
            b_w = -qn
            b_e = beta * qn + v[0, r] * v[3, c] * over_l / length
            d_alpha = (v[5, c] / length - 2.0 * alpha * v[0, c]) / length
            d_beta = (v[0, c] + v[6, c] / length - 2.0 * beta * v[0, c]) / length
            h[0, r, c] = a_u
            h[1, c, r] = -a_u - a_e
            h[3, c, r] = a_e
            h[6, r, c] = 0.0
            h[9, r, c] = -b_w
            h[8, r, c] = b_w + b_e
            h[7, r, c] = -b_e
            h[5, r, c] = (beta - 1.0) * (b_w + b_e) + b[r] * d_beta - alpha * a_e - a[r] * d_alpha
    # a rigid translation changes nothing: rows k and j sum to zero over the four nodes
    for r in range(3):
        for c in range(3):
            h[4, r, c] = -h[3, r, c] - h[8, c, r] - h[5, r, c]
    for r in range(3):
        for c in range(3):
            h[2, r, c] = -h[1, r, c] - h[7, c, r] - h[4, c, r]


@kernel(REAL(MATRIX, INDEX_TABLE, VECTOR, VECTOR, REAL, VECTOR, INDEX_TABLE, MATRIX, BLOCKS, VECTOR))
def add_hinges(x, hinges, stiffness, rest, theta1, reference, slots, force, blocks, angles):  # type: ignore[no-untyped-def]
    """Add all hinges' gradient to force and, if slots is not empty, their Hessian to blocks.

    The angle is unwrapped against `reference`, the angle at the last accepted state, and written to
    `angles`. Returns the energy [J], infinite when films have crossed.
    """
    if slots.shape[0] == 0:
        return add_hinge_gradients(x, hinges, stiffness, rest, theta1, reference, force, angles)
    v = np.empty((7, 3))
    d = np.empty((4, 3))
    h = np.empty((10, 3, 3))
    energy = 0.0
    for e in range(hinges.shape[0]):
        length, height_i, height_l, along_u, along_w, angle = _frame(x, hinges[e], v)
        if angle - reference[e] > math.pi:
            angle -= TURN
        elif angle - reference[e] < -math.pi:
            angle += TURN
        angles[e] = angle
        e_h, moment, tangent = fold_law(angle, rest[e], stiffness[e], theta1)
        energy += e_h
        if e_h == np.inf:
            continue
        alpha, beta = along_u / length, along_w / length
        for r in range(3):
            d[0, r] = v[1, r] / height_i
            d[3, r] = -v[3, r] / height_l
            d[1, r] = (alpha - 1.0) * d[0, r] - beta * d[3, r]
            d[2, r] = (beta - 1.0) * d[3, r] - alpha * d[0, r]
        for a in range(4):
            node = hinges[e, a]
            for r in range(3):
                force[node, r] += moment * d[a, r]
        _second(v, length, height_i, height_l, along_u, along_w, d[0], d[3], h)
        pair = 0
        for a in range(4):
            for b in range(a + 1):
                for r in range(3):
                    for c in range(3):
                        h[pair, r, c] = moment * h[pair, r, c] + tangent * d[a, r] * d[b, c]
                add_block(blocks, slots[e, pair], h[pair])
                pair += 1
    return energy


@final
@dataclass(frozen=True)
class Hinges:
    """All rotational springs of a body.

    Args:
        nodes: (h, 4) node indices i, j, k, l.
        stiffness: (h,) [N m/rad].
        rest_angle: (h,) [rad], stress-free angle.
        fold_barrier_rad: theta1, where the barrier begins; 0 for none.
    """

    nodes: IntArray
    stiffness: Array
    rest_angle: Array
    fold_barrier_rad: float
