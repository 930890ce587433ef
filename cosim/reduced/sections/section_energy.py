"""The condensed energy of one section: a polynomial in six strains, its coefficients splines over pressure.

Uniform cubic B-splines over pressure, fine where a film changes most: near zero.

q = arsinh(p / p_0); c(p) = sum_k B_k(q) c_k. Source: de Boor, A Practical Guide to Splines, chapter IX.

Strains x = (u, w) of a section (see `chain`): u_3 its length, (u_1, u_2) shear, (w_1, w_2) bending,
w_3 twist.
A regular polygon's film answers alike in all directions up to the fourth order (six corners; four corners: up
to the third, see `section_gaps`), so the energy depends on invariants alone,
    z = u_3 / L - 1,   b = w_1^2 + w_2^2,   s = u_1^2 + u_2^2,   q = u_1 w_2 - u_2 w_1,
    t = w_3^2,         m = -w_3 (u_1 w_1 + u_2 w_2),
    F = A(z) + b B(z) + b^2 B2(z) + b^3 B3(z) + s S(z) + q Q(z) + b q Q2(z) + t T(z)
        + c1 q^2 + c2 b s + c3 t b + c4 m
with polynomials in z of the orders in `_ORDERS`. All coefficients, and L, depend on the pressure alone.

The part of a section's energy by which square units fold: functions of the gaps between their rims.

A square's film answers differently along sides and diagonals, and stiffens where rims close. So the energy of
a section between square frames has a sum of functions of one number, over places on its rim:
    F = sum_k sum_i f_k(y_ki),    y = g / (g + l),    g = u_3 + w_1 y_i - w_2 x_i,    l = R / 5,
with g the gap [m] between the two frames at the place (x_i, y_i): the corners (k = 1), the middles of the
sides (2), and halfway to the corners (3). Each f is a uniform cubic spline, fine where rims are near.
Source of the splines: de Boor, A Practical Guide to Splines, chapter IX.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector

_SCALE_Pa = 200.0
TERMS = 4
"""Functions that differ from zero at a pressure, at most."""


class PressureSpline(NamedTuple):
    """The basis B_k over 0 to a largest pressure.

    Args:
        largest_Pa: end of the range.
        intervals: of equal length in q.
    """

    largest_Pa: float
    intervals: int = 8

    @property
    def size(self) -> int:
        """Number of basis functions."""
        return self.intervals + 3

    def pressures(self, count: int) -> tuple[float, ...]:
        """Return pressures [Pa] evenly spaced in q, 0 and the largest included."""
        q = np.linspace(0.0, math.asinh(self.largest_Pa / _SCALE_Pa), count)
        return (*(_SCALE_Pa * np.sinh(q[:-1])).tolist(), self.largest_Pa)

    def basis(self, pressure_Pa: float) -> Array:
        """Return (2, size): values and slopes d/dp [1/Pa] of all functions.

        Beyond the range the functions continue as straight lines in p.
        """
        found, terms = np.zeros((2, self.size)), np.empty((2, TERMS))
        first = active_terms(pressure_Pa, self, terms)
        found[:, first : first + TERMS] = terms
        return found

    def fill(self, pressure_Pa: float, table: Array, out: Array) -> None:
        """Fill out (m,) with the values of splines of coefficients (size, m) at a pressure."""
        spline_values(self, pressure_Pa, table, out)


@kernel
def active_terms(pressure: float, spline: PressureSpline, out: Matrix) -> int:
    """Fill out (2, TERMS): values and slopes d/dp [1/Pa] of the functions that are not zero.

    Returns the first of them. Beyond 0 to the largest pressure they continue as straight lines in p.
    """
    # a pressure that is not a number gives such weights, and a place that exists
    largest, intervals = spline.largest_Pa, spline.intervals
    inside = largest if pressure > largest else pressure if pressure > 0.0 else 0.0
    span = math.asinh(largest / _SCALE_Pa) / intervals
    place = math.asinh(inside / _SCALE_Pa) / span
    first = min(int(place), intervals - 1)
    u = place - first
    v = 1.0 - u
    slope = 1.0 / (6.0 * span * math.sqrt(inside * inside + _SCALE_Pa * _SCALE_Pa))
    out[0, 0] = v * v * v / 6.0
    out[0, 1] = (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0
    out[0, 2] = (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0
    out[0, 3] = u * u * u / 6.0
    out[1, 0] = -3.0 * slope * v * v
    out[1, 1] = slope * (9.0 * u * u - 12.0 * u)
    out[1, 2] = slope * (-9.0 * v * v + 12.0 * v)
    out[1, 3] = 3.0 * slope * u * u
    for k in range(4):
        out[0, k] += (pressure - inside) * out[1, k]
    return first


@kernel
def weighted_rows(table: Matrix, first: int, weights: Vector, out: Vector) -> None:
    """Fill out (m,) with TERMS rows of table (size, m) from `first` on, times weights (TERMS,)."""
    for k in range(out.shape[0]):
        out[k] = (
            weights[0] * table[first, k] + weights[1] * table[first + 1, k]
            + weights[2] * table[first + 2, k] + weights[3] * table[first + 3, k]
        )  # fmt: skip


@kernel
def spline_values(spline: PressureSpline, pressure: float, table: Matrix, out: Vector) -> None:
    """Fill out (m,) with the values of splines of coefficients (size, m) at a pressure [Pa]."""
    terms = small_matrix(2, TERMS)
    first = active_terms(pressure, spline, terms)
    weighted_rows(table, first, terms[0], out)


_ORDERS: Final = {"A": 6, "B": 4, "B2": 2, "B3": 1, "S": 2, "Q": 2, "Q2": 1, "T": 2}
POLYNOMIAL: Final = sum(order + 1 for order in _ORDERS.values()) + 4
GAP_KINDS, GAP_INTERVALS = 3, 12
COEFFICIENTS: Final = POLYNOMIAL + GAP_KINDS * (GAP_INTERVALS + 3)
"""Of the polynomial and of the functions of gaps (see `section_gaps`)."""
_LOWEST: Final = {"A": -1, "B": 0, "B2": 1, "B3": 2, "S": 0, "Q": 0, "Q2": 1, "T": 0}
DEGREES: Final = (
    *(max(0, power + _LOWEST[name]) for name, order in _ORDERS.items() for power in range(order + 1)),
    *(3,) * (COEFFICIENTS - POLYNOMIAL + 4),
)
"""How far each term's degree is above that of a linear spring: powers of z, products, functions of gaps."""
LOW, HIGH, BENT = COEFFICIENTS, COEFFICIENTS + 1, COEFFICIENTS + 2
"""Columns behind the coefficients: limits of z, and of b."""


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
    """Return F; fill its gradient (6,) and, if asked to, its Hessian (6, 6) with respect to the strains.

    Args:
        c: (sections, COEFFICIENTS or more).
        s: which section.
        x: (6,) strains.
        inverse_length: 1 / L [1/m].
        gradient: (6,).
        hessian: (6, 6), or (0, 6) where none is asked for.
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


_LOW: Final = -0.1  # of y: rims overlap a little, where the film between them gives way
_HIGH: Final = 0.8
_REACH: Final = 0.2
_OVERLAP: Final = 0.3  # of l; beyond a section has no energy
_FUNCTIONS: Final = GAP_INTERVALS + 3


@device_function
def _cubic(c: Matrix, s: int, first: int, place: float) -> tuple[float, float, float]:
    """Return value, slope and curvature of the spline c[s, first:], knots one apart, at a place."""
    at = min(max(int(place), 0), GAP_INTERVALS - 1)
    u = place - at
    v, k = 1.0 - u, first + at
    a, b, d, e = c[s, k], c[s, k + 1], c[s, k + 2], c[s, k + 3]
    value = a * v * v * v + b * (3.0 * u * u * u - 6.0 * u * u + 4.0)
    value += d * (3.0 * v * v * v - 6.0 * v * v + 4.0) + e * u * u * u
    slope = -a * v * v + b * (3.0 * u * u - 4.0 * u) + d * (4.0 * v - 3.0 * v * v) + e * u * u
    curvature = a * v + b * (3.0 * u - 2.0) + d * (3.0 * v - 2.0) + e * u
    return value / 6.0, 0.5 * slope, curvature


@device_function
def _place(rim: Matrix, kind: int, i: int) -> tuple[float, float]:
    """Return the coordinates [m] of a place on a frame with corners rim (n, 2)."""
    x, y = rim[i, 0], rim[i, 1]
    if kind == 1:
        k = (i + 1) % rim.shape[0]
        return 0.5 * (x + rim[k, 0]), 0.5 * (y + rim[k, 1])
    return (x, y) if kind == 0 else (0.5 * x, 0.5 * y)


@device_function
def add_gaps(c: Matrix, s: int, x: Vector, rim: Matrix, gradient: Vector, hessian: Matrix) -> float:
    """Return F, infinite where rims overlap; add its gradient and, if asked to, its Hessian.

    Args:
        c: (sections, COEFFICIENTS or more).
        s: which section.
        x: (6,) strains.
        rim: (n, 2) [m], corners of the frames; zero, or (0, 2), for none.
        gradient: (6,).
        hessian: (6, 6), or (0, 6) where none is asked for.
    """
    energy = 0.0
    if rim.shape[0] == 0 or rim[0, 0] == 0.0 == rim[0, 1]:
        return energy
    reach, per = _REACH * math.hypot(rim[0, 0], rim[0, 1]), GAP_INTERVALS / (_HIGH - _LOW)
    for kind in range(GAP_KINDS):
        for i in range(rim.shape[0]):
            along, across = _place(rim, kind, i)
            gap = x[2] + x[3] * across - x[4] * along
            if gap < -_OVERLAP * reach:
                return math.inf
            inverse = 1.0 / (gap + reach)
            rate = per * reach * inverse * inverse
            first = POLYNOMIAL + kind * _FUNCTIONS
            value, slope, curvature = _cubic(c, s, first, per * (gap * inverse - _LOW))
            energy += value
            pull = slope * rate
            gradient[2] += pull
            gradient[3] += pull * across
            gradient[4] -= pull * along
            if hessian.shape[0] > 0:
                stiff = curvature * rate * rate - 2.0 * pull * inverse
                hessian[2, 2] += stiff
                hessian[3, 3] += stiff * across * across
                hessian[4, 4] += stiff * along * along
                for row, column, factor in ((3, 2, across), (4, 2, -along), (4, 3, -along * across)):
                    hessian[row, column] += stiff * factor
                    hessian[column, row] += stiff * factor
    return energy


@kernel(allocates=True)
def basis(strains: Matrix, inverse_length: Vector, rim: Matrix, values: Matrix, gradients: Blocks) -> None:
    """Fill values (n, COEFFICIENTS) and gradients (n, 6, COEFFICIENTS) of every term, coefficient one."""
    count = values.shape[1]
    unit = np.zeros((1, count))
    gradient = small_vector(6)
    none = small_matrix(0, 6)
    for i in range(strains.shape[0]):
        for k in range(count):
            unit[0, k] = 1.0
            values[i, k] = section_energy(unit, 0, strains[i], inverse_length[i], gradient, none)
            values[i, k] += add_gaps(unit, 0, strains[i], rim, gradient, none)
            unit[0, k] = 0.0
            for r in range(6):
                gradients[i, r, k] = gradient[r]
