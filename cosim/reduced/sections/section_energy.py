"""The condensed energy of one section: a polynomial in six strains; coefficients are splines over pressure.

The strains of a section (see `section_strains`) are x = (u, w): u_3 its length, (u_1, u_2) shear, (w_1, w_2)
bending, w_3 twist. The film of a regular polygon has the same response in all directions up to the fourth
order (six corners; four: up to the third, see `gap_energy`), so the energy depends on invariants alone:
    z = u_3 / L - 1,   b = w_1^2 + w_2^2,   s = u_1^2 + u_2^2,   q = u_1 w_2 - u_2 w_1,
    t = w_3^2,         m = -w_3 (u_1 w_1 + u_2 w_2),
    F = A(z) + b B(z) + b^2 B2(z) + b^3 B3(z) + s S(z) + q Q(z) + b q Q2(z) + t T(z)
        + c1 q^2 + c2 b s + c3 t b + c4 m
with polynomials in z of the orders of `coefficients`. All coefficients, and L, depend on the pressure alone.
"""

import numpy as np

from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.reduced.sections.gap_energy import add_gaps


@device_function
def _polynomial(c: Matrix, s: int, first: int, order: int, z: float) -> tuple[float, float, float]:
    """Return value, slope and curvature of sum_k c[s, first + k] z^k."""
    value = slope = curvature = 0.0
    for k in range(order, -1, -1):
        curvature = curvature * z + 2.0 * slope
        slope = slope * z + value
        value = value * z + c[s, first + k]
    return value, slope, curvature


@device_function
def section_energy(
    c: Matrix, s: int, x: Vector, inverse_length: float, gradient: Vector, hessian: Matrix
) -> float:
    """Return F; fill its gradient (6,) and, unless `hessian` is empty, Hessian (6, 6) by the strains.

    Args:
        c: (sections, COEFFICIENTS or more).
        s: which section.
        x: (6,) strains.
        inverse_length: 1 / L [1/m].
        gradient: (6,).
        hessian: (6, 6); (0, 6) if it is not needed.
    """
    u1, u2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    z = x[2] * inverse_length - 1.0
    b, shear, t, q = w1 * w1 + w2 * w2, u1 * u1 + u2 * u2, w3 * w3, u1 * w2 - u2 * w1
    a, az, azz = _polynomial(c, s, 0, 6, z)
    bend, bend_z, bend_zz = _polynomial(c, s, 7, 4, z)
    bend2, bend2_z, bend2_zz = _polynomial(c, s, 12, 2, z)
    bend3, bend3_z, _ = _polynomial(c, s, 15, 1, z)
    sh, sh_z, sh_zz = _polynomial(c, s, 17, 2, z)
    mix, mix_z, mix_zz = _polynomial(c, s, 20, 2, z)
    mix2, mix2_z, _ = _polynomial(c, s, 23, 1, z)
    tw, tw_z, tw_zz = _polynomial(c, s, 25, 2, z)
    c1, c2, c3, c4 = c[s, 28], c[s, 29], c[s, 30], c[s, 31]
    # derivatives by the invariants
    f_z = az + b * (bend_z + b * (bend2_z + b * bend3_z)) + shear * sh_z + q * (mix_z + b * mix2_z) + t * tw_z
    f_b = bend + b * (2.0 * bend2 + 3.0 * b * bend3) + q * mix2 + c2 * shear + c3 * t
    f_s = sh + c2 * b
    f_q = mix + b * mix2 + 2.0 * c1 * q
    f_t = tw + c3 * b
    gradient[0] = 2.0 * u1 * f_s + w2 * f_q - c4 * w3 * w1
    gradient[1] = 2.0 * u2 * f_s - w1 * f_q - c4 * w3 * w2
    gradient[2] = inverse_length * f_z
    gradient[3] = 2.0 * w1 * f_b - u2 * f_q - c4 * w3 * u1
    gradient[4] = 2.0 * w2 * f_b + u1 * f_q - c4 * w3 * u2
    gradient[5] = 2.0 * w3 * f_t - c4 * (u1 * w1 + u2 * w2)
    if hessian.shape[0] > 0:
        f_zz = azz + b * (bend_zz + b * bend2_zz) + shear * sh_zz + q * mix_zz + t * tw_zz
        f_zb = bend_z + b * (2.0 * bend2_z + 3.0 * b * bend3_z) + q * mix2_z
        f_bb = 2.0 * bend2 + 6.0 * b * bend3
        f_zq = mix_z + b * mix2_z
        by_stretch, by_bend = (f_zz, f_zb, sh_z, f_zq, tw_z), (f_b, f_s, f_q, f_t, f_bb, mix2, 2.0 * c1)
        _fill_hessian(x, inverse_length, by_stretch, by_bend, (c2, c3, c4), hessian)
    return (
        a + b * (bend + b * (bend2 + b * bend3)) + shear * sh + q * (mix + b * mix2)
        + c1 * q * q + c2 * b * shear + t * (tw + c3 * b) - c4 * w3 * (u1 * w1 + u2 * w2)
    )  # fmt: skip


@device_function
def _fill_hessian(
    x: Vector,
    inverse_length: float,
    by_stretch: tuple[float, float, float, float, float],
    by_bend: tuple[float, float, float, float, float, float, float],
    mixed: tuple[float, float, float],
    hessian: Matrix,
) -> None:
    """Fill the Hessian from derivatives by z and (z, b, s, q, t), by (b, s, q, t), and by bb, bq, qq."""
    f_zz, f_zb, f_zs, f_zq, f_zt = by_stretch
    f_b, f_s, f_q, f_t, f_bb, f_bq, f_qq = by_bend
    c2, c3, c4 = mixed
    u1, u2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    hessian[2, 2] = inverse_length * inverse_length * f_zz
    hessian[2, 0] = inverse_length * (2.0 * u1 * f_zs + w2 * f_zq)
    hessian[2, 1] = inverse_length * (2.0 * u2 * f_zs - w1 * f_zq)
    hessian[2, 3] = inverse_length * (2.0 * w1 * f_zb - u2 * f_zq)
    hessian[2, 4] = inverse_length * (2.0 * w2 * f_zb + u1 * f_zq)
    hessian[2, 5] = inverse_length * 2.0 * w3 * f_zt
    for k in (0, 1, 3, 4, 5):
        hessian[k, 2] = hessian[2, k]
    hessian[0, 0] = 2.0 * f_s + w2 * w2 * f_qq
    hessian[1, 0] = -w1 * w2 * f_qq
    hessian[1, 1] = 2.0 * f_s + w1 * w1 * f_qq
    along_1, along_2 = 2.0 * w1 * f_bq - u2 * f_qq, 2.0 * w2 * f_bq + u1 * f_qq  # of f_q, by w_1 and w_2
    hessian[3, 0] = 4.0 * c2 * u1 * w1 + w2 * along_1 - c4 * w3
    hessian[4, 0] = 4.0 * c2 * u1 * w2 + w2 * along_2 + f_q
    hessian[5, 0] = -c4 * w1
    hessian[3, 1] = 4.0 * c2 * u2 * w1 - w1 * along_1 - f_q
    hessian[4, 1] = 4.0 * c2 * u2 * w2 - w1 * along_2 - c4 * w3
    hessian[5, 1] = -c4 * w2
    hessian[3, 3] = 2.0 * f_b + 2.0 * w1 * (2.0 * w1 * f_bb - u2 * f_bq) - u2 * along_1
    hessian[4, 3] = 2.0 * w2 * (2.0 * w1 * f_bb - u2 * f_bq) + u1 * along_1
    hessian[4, 4] = 2.0 * f_b + 2.0 * w2 * (2.0 * w2 * f_bb + u1 * f_bq) + u1 * along_2
    hessian[5, 3] = 4.0 * c3 * w1 * w3 - c4 * u1
    hessian[5, 4] = 4.0 * c3 * w2 * w3 - c4 * u2
    hessian[5, 5] = 2.0 * f_t
    for i, k in ((1, 0), (3, 0), (4, 0), (5, 0), (3, 1), (4, 1), (5, 1), (4, 3), (5, 3), (5, 4)):
        hessian[k, i] = hessian[i, k]


@kernel(allocates=True)
def basis(strains: Matrix, inverse_length: Vector, rim: Matrix, values: Matrix, gradients: Blocks) -> None:
    """Fill values (n, COEFFICIENTS) and gradients (n, 6, COEFFICIENTS) of every term, coefficient one."""
    count = values.shape[1]
    unit = np.zeros((1, count))
    gradient = small_vector(6)
    no_hessian = small_matrix(0, 6)
    for i in range(strains.shape[0]):
        for k in range(count):
            unit[0, k] = 1.0
            values[i, k] = section_energy(unit, 0, strains[i], inverse_length[i], gradient, no_hessian)
            values[i, k] += add_gaps(unit, 0, strains[i], rim, gradient, no_hessian)
            unit[0, k] = 0.0
            for r in range(6):
                gradients[i, r, k] = gradient[r]
