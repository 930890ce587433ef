"""The condensed energy of one section: a polynomial in six strains of the pose of two frames.

Strains x = (u, w) of section a-b (see `chain`): u_3 its length, (u_1, u_2) shear, (w_1, w_2) bending, w_3 twist.
A regular polygon's film answers alike in all directions up to the fourth order (six corners; four corners: up
to the third), so the energy depends on invariants alone,
    z = u_3 / L - 1,   b = w_1^2 + w_2^2,   s = u_1^2 + u_2^2,   q = u_1 w_2 - u_2 w_1,
    t = w_3^2,         m = -w_3 (u_1 w_1 + u_2 w_2),
    F = A(z) + b B(z) + b^2 B2(z) + b^3 B3(z) + s S(z) + q Q(z) + b q Q2(z) + c1 q^2 + c2 b s + t T(z) + c3 t b + c4 m
with polynomials in z of the orders in `_ORDERS`. All coefficients, and L, depend on the pressure alone.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cosim.kernels import MATRIX, VECTOR, inlined, kernel
from numba import float64, void

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
def section_energy(c, x, inverse_length, gradient, hessian, work):  # type: ignore[no-untyped-def]
    """Return F; fill its gradient (6,) and Hessian (6, 6) with respect to the strains.

    Args:
        c: (COEFFICIENTS,).
        x: (6,) strains.
        inverse_length: 1 / L [1/m].
        gradient: (6,).
        hessian: (6, 6).
        work: (14, 6) scratch.
    """
    s1, s2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    z = x[2] * inverse_length - 1.0
    b, s, t = w1 * w1 + w2 * w2, s1 * s1 + s2 * s2, w3 * w3
    q, m = s1 * w2 - s2 * w1, -w3 * (s1 * w1 + s2 * w2)
    pa, pb, pb2, pb3 = work[0], work[1], work[2], work[3]
    ps, pq, pq2, pt = work[4], work[5], work[6], work[7]
    _polynomial(c, 0, 6, z, pa)
    _polynomial(c, 7, 4, z, pb)
    _polynomial(c, 12, 2, z, pb2)
    _polynomial(c, 15, 1, z, pb3)
    _polynomial(c, 17, 2, z, ps)
    _polynomial(c, 20, 2, z, pq)
    _polynomial(c, 23, 1, z, pq2)
    _polynomial(c, 25, 2, z, pt)
    c1, c2, c3, c4 = c[28], c[29], c[30], c[31]
    energy = (
        pa[0] + b * (pb[0] + b * (pb2[0] + b * pb3[0])) + s * ps[0] + q * (pq[0] + b * pq2[0])
        + c1 * q * q + c2 * b * s + t * (pt[0] + c3 * b) + c4 * m
    )  # fmt: skip
    fz = pa[1] + b * (pb[1] + b * (pb2[1] + b * pb3[1])) + s * ps[1] + q * (pq[1] + b * pq2[1]) + t * pt[1]
    fzz = pa[2] + b * (pb[2] + b * (pb2[2] + b * pb3[2])) + s * ps[2] + q * (pq[2] + b * pq2[2]) + t * pt[2]
    fb = pb[0] + b * (2.0 * pb2[0] + 3.0 * b * pb3[0]) + q * pq2[0] + c2 * s + c3 * t
    fbz = pb[1] + b * (2.0 * pb2[1] + 3.0 * b * pb3[1]) + q * pq2[1]
    fbb = 2.0 * pb2[0] + 6.0 * b * pb3[0]
    fs, ft = ps[0] + c2 * b, pt[0] + c3 * b
    fq, fqz, fqq = pq[0] + b * pq2[0] + 2.0 * c1 * q, pq[1] + b * pq2[1], 2.0 * c1
    # gradients of b, s, q, t with respect to the strains, and of z
    gz, gb, gs, gq, gt = work[8], work[9], work[10], work[11], work[12]
    for k in range(6):
        gz[k] = gb[k] = gs[k] = gq[k] = gt[k] = 0.0
    gz[2] = inverse_length
    gb[3], gb[4] = 2.0 * w1, 2.0 * w2
    gs[0], gs[1] = 2.0 * s1, 2.0 * s2
    gq[0], gq[1], gq[3], gq[4] = w2, -w1, -s2, s1
    gt[5] = 2.0 * w3
    for k in range(6):
        gradient[k] = fz * gz[k] + fb * gb[k] + fs * gs[k] + fq * gq[k] + ft * gt[k]
    gradient[0] -= c4 * w3 * w1
    gradient[1] -= c4 * w3 * w2
    gradient[3] -= c4 * w3 * s1
    gradient[4] -= c4 * w3 * s2
    gradient[5] -= c4 * (s1 * w1 + s2 * w2)
    mixed = work[13]
    for i in range(6):
        mixed[i] = (
            fbz * gb[i] + ps[1] * gs[i] + fqz * gq[i] + pt[1] * gt[i] + 0.5 * fzz * gz[i]
        )  # what stands beside dz
    for i in range(6):
        row_b = 0.5 * fbb * gb[i] + pq2[0] * gq[i] + c2 * gs[i] + c3 * gt[i]
        row_q = 0.5 * fqq * gq[i]
        for k in range(6):
            hessian[i, k] = mixed[i] * gz[k] + row_b * gb[k] + row_q * gq[k]
    for i in range(6):
        for k in range(i + 1):
            total = hessian[i, k] + hessian[k, i]
            hessian[i, k] = hessian[k, i] = total
    hessian[3, 3] += 2.0 * fb
    hessian[4, 4] += 2.0 * fb
    hessian[0, 0] += 2.0 * fs
    hessian[1, 1] += 2.0 * fs
    hessian[5, 5] += 2.0 * ft
    for i, k, value in (
        (0, 4, fq), (1, 3, -fq), (0, 3, -c4 * w3), (1, 4, -c4 * w3),
        (0, 5, -c4 * w1), (1, 5, -c4 * w2), (3, 5, -c4 * s1), (4, 5, -c4 * s2),
    ):  # fmt: skip
        hessian[i, k] += value
        hessian[k, i] += value
    return energy


@kernel(void(MATRIX, VECTOR, MATRIX, float64[:, :, ::1]))
def basis(strains, inverse_length, values, gradients):  # type: ignore[no-untyped-def]
    """Fill values (n, COEFFICIENTS) and gradients (n, 6, COEFFICIENTS) of every term, coefficient one."""
    count = values.shape[1]
    unit = np.zeros(count)
    gradient = np.empty(6)
    hessian = np.empty((6, 6))
    work = np.empty((14, 6))
    for i in range(strains.shape[0]):
        for k in range(count):
            unit[k] = 1.0
            values[i, k] = section_energy(unit, strains[i], inverse_length[i], gradient, hessian, work)
            unit[k] = 0.0
            for r in range(6):
                gradients[i, r, k] = gradient[r]
