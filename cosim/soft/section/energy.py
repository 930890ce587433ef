"""The condensed energy of one section: a polynomial in six strains of the pose of two frames.

Strains x = (u, w) of a section (see `chain`): u_3 its length, (u_1, u_2) shear, (w_1, w_2) bending,
w_3 twist.
A regular polygon's film answers alike in all directions up to the fourth order (six corners; four corners: up
to the third), so the energy depends on invariants alone,
    z = u_3 / L - 1,   b = w_1^2 + w_2^2,   s = u_1^2 + u_2^2,   q = u_1 w_2 - u_2 w_1,
    t = w_3^2,         m = -w_3 (u_1 w_1 + u_2 w_2),
    F = A(z) + b B(z) + b^2 B2(z) + b^3 B3(z) + s S(z) + q Q(z) + b q Q2(z) + t T(z)
        + c1 q^2 + c2 b s + c3 t b + c4 m
with polynomials in z of the orders in `_ORDERS`. All coefficients, and L, depend on the pressure alone.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import float64, void

from cosim.kernels import MATRIX, VECTOR, inlined, kernel

_ORDERS: Final = {"A": 6, "B": 4, "B2": 2, "B3": 1, "S": 2, "Q": 2, "Q2": 1, "T": 2}
COEFFICIENTS: Final = sum(order + 1 for order in _ORDERS.values()) + 4
LOW, HIGH, BENT = COEFFICIENTS, COEFFICIENTS + 1, COEFFICIENTS + 2
"""Columns behind the coefficients: limits of z, and of b."""


@inlined
def _polynomial(c, first, order, z, out):  # type: ignore[no-untyped-def]
    """Fill out with value, slope and curvature of sum_k c[first + k] z^k."""
    value = slope = curvature = 0.0
    for k in range(order, -1, -1):
        curvature = curvature * z + 2.0 * slope
        slope = slope * z + value
        value = value * z + c[first + k]
    out[0], out[1], out[2] = value, slope, curvature


@inlined
def _invariants(c, x, inverse_length, f, work):  # type: ignore[no-untyped-def]
    """Return F; fill f (13,) with its derivatives by the invariants.

    In this order: z, zz, b, bz, bb, s, sz, q, qz, qq, bq, t, tz.
    """
    s1, s2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    z = x[2] * inverse_length - 1.0
    b, s, t = w1 * w1 + w2 * w2, s1 * s1 + s2 * s2, w3 * w3
    q, m = s1 * w2 - s2 * w1, -w3 * (s1 * w1 + s2 * w2)
    pa, pb, pb2, pb3, ps, pq, pq2, pt = work
    _polynomial(c, 0, 6, z, pa)
    _polynomial(c, 7, 4, z, pb)
    _polynomial(c, 12, 2, z, pb2)
    _polynomial(c, 15, 1, z, pb3)
    _polynomial(c, 17, 2, z, ps)
    _polynomial(c, 20, 2, z, pq)
    _polynomial(c, 23, 1, z, pq2)
    _polynomial(c, 25, 2, z, pt)
    c1, c2, c3, c4 = c[28], c[29], c[30], c[31]
    for k in (1, 2):
        bent = b * (pb[k] + b * (pb2[k] + b * pb3[k]))
        f[k - 1] = pa[k] + bent + s * ps[k] + q * (pq[k] + b * pq2[k]) + t * pt[k]
    f[2] = pb[0] + b * (2.0 * pb2[0] + 3.0 * b * pb3[0]) + q * pq2[0] + c2 * s + c3 * t
    f[3] = pb[1] + b * (2.0 * pb2[1] + 3.0 * b * pb3[1]) + q * pq2[1]
    f[4] = 2.0 * pb2[0] + 6.0 * b * pb3[0]
    f[5], f[6] = ps[0] + c2 * b, ps[1]
    f[7], f[8], f[9], f[10] = pq[0] + b * pq2[0] + 2.0 * c1 * q, pq[1] + b * pq2[1], 2.0 * c1, pq2[0]
    f[11], f[12] = pt[0] + c3 * b, pt[1]
    return (
        pa[0] + b * (pb[0] + b * (pb2[0] + b * pb3[0])) + s * ps[0] + q * (pq[0] + b * pq2[0])
        + c1 * q * q + c2 * b * s + t * (pt[0] + c3 * b) + c4 * m
    )  # fmt: skip


@inlined
def section_energy(c, x, inverse_length, gradient, hessian, work):  # type: ignore[no-untyped-def]
    """Return F; fill its gradient (6,) and Hessian (6, 6) with respect to the strains.

    Args:
        c: (COEFFICIENTS,).
        x: (6,) strains.
        inverse_length: 1 / L [1/m].
        gradient: (6,).
        hessian: (6, 6).
        work: (15, 13) scratch.
    """
    f, slopes = work[0], work[1:6]
    energy = _invariants(c, x, inverse_length, f, work[6:14])
    s1, s2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    # gradients of z, b, s, q, t with respect to the strains
    slopes[:, :6] = 0.0
    slopes[0, 2] = inverse_length
    slopes[1, 3], slopes[1, 4] = 2.0 * w1, 2.0 * w2
    slopes[2, 0], slopes[2, 1] = 2.0 * s1, 2.0 * s2
    slopes[3, 0], slopes[3, 1], slopes[3, 3], slopes[3, 4] = w2, -w1, -s2, s1
    slopes[4, 5] = 2.0 * w3
    for k in range(6):
        gradient[k] = (
            f[0] * slopes[0, k] + f[2] * slopes[1, k] + f[5] * slopes[2, k] + f[7] * slopes[3, k]
            + f[11] * slopes[4, k]
        )  # fmt: skip
    c4 = c[31]
    gradient[0] -= c4 * w3 * w1
    gradient[1] -= c4 * w3 * w2
    gradient[3] -= c4 * w3 * s1
    gradient[4] -= c4 * w3 * s2
    gradient[5] -= c4 * (s1 * w1 + s2 * w2)
    _curvature(c, x, f, slopes, hessian)
    return energy


@inlined
def _curvature(c, x, f, slopes, hessian):  # type: ignore[no-untyped-def]
    """Fill the Hessian by the strains from the derivatives by the invariants."""
    s1, s2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    c2, c3, c4 = c[29], c[30], c[31]
    gz, gb, gs, gq, gt = slopes[0], slopes[1], slopes[2], slopes[3], slopes[4]
    for i in range(6):
        row_z = 0.5 * f[1] * gz[i] + f[3] * gb[i] + f[6] * gs[i] + f[8] * gq[i] + f[12] * gt[i]
        row_b = 0.5 * f[4] * gb[i] + f[10] * gq[i] + c2 * gs[i] + c3 * gt[i]
        row_q = 0.5 * f[9] * gq[i]
        for k in range(6):
            hessian[i, k] = row_z * gz[k] + row_b * gb[k] + row_q * gq[k]
    for i in range(6):
        for k in range(i + 1):
            total = hessian[i, k] + hessian[k, i]
            hessian[i, k] = hessian[k, i] = total
    hessian[3, 3] += 2.0 * f[2]
    hessian[4, 4] += 2.0 * f[2]
    hessian[0, 0] += 2.0 * f[5]
    hessian[1, 1] += 2.0 * f[5]
    hessian[5, 5] += 2.0 * f[11]
    for i, k, value in (
        (0, 4, f[7]), (1, 3, -f[7]), (0, 3, -c4 * w3), (1, 4, -c4 * w3),
        (0, 5, -c4 * w1), (1, 5, -c4 * w2), (3, 5, -c4 * s1), (4, 5, -c4 * s2),
    ):  # fmt: skip
        hessian[i, k] += value
        hessian[k, i] += value


@kernel(void(MATRIX, VECTOR, MATRIX, float64[:, :, ::1]))
def basis(strains, inverse_length, values, gradients):  # type: ignore[no-untyped-def]
    """Fill values (n, COEFFICIENTS) and gradients (n, 6, COEFFICIENTS) of every term, coefficient one."""
    count = values.shape[1]
    unit = np.zeros(count)
    gradient = np.empty(6)
    hessian = np.empty((6, 6))
    work = np.empty((15, 13))
    for i in range(strains.shape[0]):
        for k in range(count):
            unit[k] = 1.0
            values[i, k] = section_energy(unit, strains[i], inverse_length[i], gradient, hessian, work)
            unit[k] = 0.0
            for r in range(6):
                gradients[i, r, k] = gradient[r]
