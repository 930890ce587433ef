"""The condensed energy of one section: a function of six strains, its coefficients splines over pressure.

Uniform cubic B-splines over pressure, fine where a film changes most: near zero.

q = arsinh(p / p_0); c(p) = sum_k B_k(q) c_k. Source: de Boor, A Practical Guide to Splines, chapter IX.

Strains x = (u, w) of a section (see `chain`): u_3 its length, (u_1, u_2) shear, (w_1, w_2) bending,
w_3 twist. With
    z = u_3 / L - 1,   b = w_1^2 + w_2^2,   y = sqrt(b + y_0^2) - y_0,   s = u_1^2 + u_2^2,   t = w_3^2,
    q = u_1 w_2 - u_2 w_1,   m = -w_3 (u_1 w_1 + u_2 w_2),   h = Re[(w_1 + i w_2)^n e^(-i n phi)]
    F = A(z, y) + s S(z, y) + q Q(z, y) + t T(z, y) + h H(z, y) + c1 q^2 + c2 m.
A regular polygon's film answers alike in all directions up to order n, the number of its corners; h tells
bending across edges from bending across corners, the first of them at the angle phi. y is b for small bends
and the bend itself for large ones. A is a tensor product of uniform cubic B-splines, which follows a film that
bends freely until its units meet; beyond the last knots they go on as straight lines. S, Q, T and H are
polynomials of second order in y and z, H of first in z. All coefficients, and L, depend on the pressure alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernels import Blocks, Matrix, Vector, device_function, kernel, small_matrix, small_vector

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

        Beyond the range the functions go on as straight lines in p.
        """
        found: Array = self.bases(np.array((pressure_Pa,)))[0]
        return found

    def bases(self, pressure_Pa: Array) -> Array:
        """Return `basis` of many pressures (k,) [Pa]: (k, 2, size)."""
        result = np.zeros((len(pressure_Pa), 2, self.size))
        for row, pressure in zip(result, pressure_Pa.tolist(), strict=True):
            terms = self.terms(pressure)
            row[:, terms.first : terms.first + TERMS] = terms.weights
        return result

    def terms(self, pressure_Pa: float) -> SplineTerms:
        """Return the functions that are not zero at a pressure."""
        weights = np.empty((2, TERMS))
        return SplineTerms(active_terms(pressure_Pa, self, weights), weights)


@kernel(taken_in=True)
def active_terms(pressure: float, spline: PressureSpline, out: Matrix) -> int:
    """Fill out (2, TERMS): values and slopes d/dp [1/Pa] of the functions that are not zero.

    Returns the first of them. Beyond 0 to the largest pressure they go on as straight lines in p.
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


@kernel(taken_in=True)
def weighted_rows(table: Matrix, first: int, weights: Vector, out: Vector) -> None:
    """Fill out (m,) with TERMS rows of table (size, m) from `first` on, times weights (TERMS,)."""
    for k in range(out.shape[0]):
        out[k] = (
            weights[0] * table[first, k] + weights[1] * table[first + 1, k]
            + weights[2] * table[first + 2, k] + weights[3] * table[first + 3, k]
        )  # fmt: skip


@final
@dataclass(frozen=True)
class SplineTerms:
    """The functions of a spline that are not zero at one pressure.

    Args:
        first: of them; the others follow it.
        weights: (2, TERMS), their values and slopes d/dp [1/Pa].
    """

    first: int
    weights: Array

    def values(self, table: Array, out: Array) -> None:
        """Fill out (m,) with the values of splines of coefficients (size, m)."""
        weighted_rows(table, self.first, self.weights[0], out)


Z_CELLS: Final = 6
"""Intervals of A over z."""
Y_CELLS: Final = 8
"""The same over y."""
ROWS, LINE = Z_CELLS + 3, Y_CELLS + 3
"""Splines over z and over y; coefficients of A come row after row."""
BEND: Final = 0.05
"""y_0."""
_S = ROWS * LINE
_Q, _T, _H, _MIXED = _S + 9, _S + 18, _S + 27, _S + 33
TURNED: Final = slice(_Q, _T)
"""Coefficients of Q."""
COEFFICIENTS: Final = _MIXED + 2
LOW, HIGH, BENT = COEFFICIENTS, COEFFICIENTS + 1, COEFFICIENTS + 2
"""Columns behind the coefficients: limits of z, and of b."""
Z_FROM, Z_STEP, Y_STEP, CORNERS, COSINE, SINE = range(COEFFICIENTS + 3, COEFFICIENTS + 9)
"""Columns behind these, alike at all pressures: first knot and interval in z, interval in y, n, cos and sin n phi."""
COLUMNS: Final = COEFFICIENTS + 9


def bends(bend: Array) -> Array:
    """Return y of bends sqrt(b)."""
    return np.hypot(bend, BEND) - BEND


@device_function
def _uniform(place: float, cells: int, out: Matrix) -> int:
    """Fill out (3, 4): values, slopes and curvatures of the cubic B-splines at a place in units of intervals.

    Returns the first of them. Beyond 0 to `cells` they go on as straight lines.
    """
    inside = min(max(place, 0.0), float(cells))
    first = min(int(inside), cells - 1)
    u = inside - first
    v = 1.0 - u
    out[0, 0] = v * v * v / 6.0
    out[0, 1] = (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0
    out[0, 2] = (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0
    out[0, 3] = u * u * u / 6.0
    out[1, 0] = -0.5 * v * v
    out[1, 1] = 1.5 * u * u - 2.0 * u
    out[1, 2] = -1.5 * v * v + 2.0 * v
    out[1, 3] = 0.5 * u * u
    out[2, 0], out[2, 1], out[2, 2], out[2, 3] = v, 3.0 * u - 2.0, 3.0 * v - 2.0, u
    if place != inside:
        for k in range(4):
            out[0, k] += (place - inside) * out[1, k]
            out[2, k] = 0.0
    return first


@device_function
def _tensor(c: Matrix, s: int, z: float, y: float, out: Vector) -> None:
    """Fill out (6,): A and its derivatives by z, y, zz, zy and yy."""
    along, across = small_matrix(3, 4), small_matrix(3, 4)
    by_z, by_y = 1.0 / c[s, Z_STEP], 1.0 / c[s, Y_STEP]
    row = _uniform((z - c[s, Z_FROM]) * by_z, Z_CELLS, along)
    line = _uniform(y * by_y, Y_CELLS, across)
    for k in range(6):
        out[k] = 0.0
    for i in range(4):
        at = (row + i) * LINE + line
        value = slope = curvature = 0.0
        for k in range(4):
            value += across[0, k] * c[s, at + k]
            slope += across[1, k] * c[s, at + k]
            curvature += across[2, k] * c[s, at + k]
        out[0] += along[0, i] * value
        out[1] += along[1, i] * value
        out[2] += along[0, i] * slope
        out[3] += along[2, i] * value
        out[4] += along[1, i] * slope
        out[5] += along[0, i] * curvature
    out[1] *= by_z
    out[2] *= by_y
    out[3] *= by_z * by_z
    out[4] *= by_z * by_y
    out[5] *= by_y * by_y


@device_function
def _add_product(
    c: Matrix, s: int, terms: tuple[int, int], place: tuple[float, float], share: float, out: Vector
) -> float:
    """Add a share of sum_ik c z^i y^k, i up to an order and k up to 2, and of its derivatives, to out (6,).

    Returns the sum; its own derivatives by z and y follow in out (8,). terms: first column, order in z.
    """
    (first, order), (z, y) = terms, place
    value = z_ = y_ = zz = zy = yy = 0.0
    for i in range(order, -1, -1):
        a, b, d = c[s, first + 3 * i], c[s, first + 3 * i + 1], c[s, first + 3 * i + 2]
        line, slope, curvature = a + y * (b + y * d), b + 2.0 * y * d, 2.0 * d
        zz = zz * z + 2.0 * z_
        z_ = z_ * z + value
        zy = zy * z + y_
        value = value * z + line
        y_ = y_ * z + slope
        yy = yy * z + curvature
    out[0] += share * value
    out[1] += share * z_
    out[2] += share * y_
    out[3] += share * zz
    out[4] += share * zy
    out[5] += share * yy
    out[6], out[7] = z_, y_
    return value


@device_function
def _corner_waves(w1: float, w2: float, c: Matrix, s: int, out: Vector) -> None:
    """Fill out (6,): h and its derivatives by w_1, w_2, w_1 w_1, w_1 w_2 and w_2 w_2."""
    n, re, im = int(c[s, CORNERS]), c[s, COSINE], -c[s, SINE]
    for k in range(6):
        out[k] = 0.0
    if n < 2:
        return
    for _ in range(n - 2):
        re, im = re * w1 - im * w2, re * w2 + im * w1
    factor = float(n * (n - 1))
    out[3], out[4], out[5] = factor * re, -factor * im, -factor * re
    re, im = re * w1 - im * w2, re * w2 + im * w1
    out[1], out[2] = n * re, -n * im
    out[0] = re * w1 - im * w2


@device_function
def section_energy(
    c: Matrix, s: int, x: Vector, inverse_length: float, gradient: Vector, hessian: Matrix
) -> float:
    """Return F; fill its gradient (6,) and, if asked to, its Hessian (6, 6) with respect to the strains.

    Args:
        c: (sections, COLUMNS).
        s: which section.
        x: (6,) strains.
        inverse_length: 1 / L [1/m].
        gradient: (6,).
        hessian: (6, 6), or (0, 6) where none is asked for.
    """
    u1, u2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    z = x[2] * inverse_length - 1.0
    b, shear, t, q = w1 * w1 + w2 * w2, u1 * u1 + u2 * u2, w3 * w3, u1 * w2 - u2 * w1
    root = np.sqrt(b + BEND * BEND)
    y, y_b = root - BEND, 0.5 / root
    # value and derivatives by z and y of all that multiplies; of S, Q, T, H by z and y
    f, wave = small_vector(8), small_vector(6)
    _tensor(c, s, z, y, f)
    _corner_waves(w1, w2, c, s, wave)
    sh = _add_product(c, s, (_S, 2), (z, y), shear, f)
    sh_z, sh_b = f[6], y_b * f[7]
    mix = _add_product(c, s, (_Q, 2), (z, y), q, f)
    mix_z, mix_b = f[6], y_b * f[7]
    tw = _add_product(c, s, (_T, 2), (z, y), t, f)
    tw_z, tw_b = f[6], y_b * f[7]
    high = _add_product(c, s, (_H, 1), (z, y), wave[0], f)
    high_z, high_b = f[6], y_b * f[7]
    c1, c2 = c[s, _MIXED], c[s, _MIXED + 1]
    f_z, f_b = f[1], y_b * f[2]
    f_q = mix + 2.0 * c1 * q
    gradient[0] = 2.0 * u1 * sh + w2 * f_q - c2 * w3 * w1
    gradient[1] = 2.0 * u2 * sh - w1 * f_q - c2 * w3 * w2
    gradient[2] = inverse_length * f_z
    gradient[3] = 2.0 * w1 * f_b - u2 * f_q + high * wave[1] - c2 * w3 * u1
    gradient[4] = 2.0 * w2 * f_b + u1 * f_q + high * wave[2] - c2 * w3 * u2
    gradient[5] = 2.0 * w3 * tw - c2 * (u1 * w1 + u2 * w2)
    if hessian.shape[0] > 0:
        f_zb = y_b * f[4]
        # d y_b / d b = -1 / (4 root^3)
        f_bb = y_b * y_b * f[5] - f[2] * y_b * y_b / root
        il = inverse_length
        by_stretch = (il * il * f[3], il * f_zb, il * sh_z, il * mix_z, il * tw_z, il * high_z)
        by_bend = (f_b, f_bb, sh_b, mix_b, tw_b, high_b)
        _fill_hessian(x, by_stretch, by_bend, (sh, f_q, tw, high, 2.0 * c1, c2), wave, hessian)
    return f[0] + c1 * q * q - c2 * w3 * (u1 * w1 + u2 * w2)


@device_function
def _fill_hessian(
    x: Vector,
    by_stretch: tuple[float, float, float, float, float, float],
    by_bend: tuple[float, float, float, float, float, float],
    first: tuple[float, float, float, float, float, float],
    wave: Vector,
    hessian: Matrix,
) -> None:
    """Fill the Hessian from derivatives by lengths (u_3 and u_3, b, s, q, t, h), bends and others."""
    f_zz, f_zb, f_zs, f_zq, f_zt, f_zh = by_stretch
    f_b, f_bb, f_bs, f_bq, f_bt, f_bh = by_bend
    f_s, f_q, f_t, f_h, f_qq, f_m = first
    u1, u2, w1, w2, w3 = x[0], x[1], x[3], x[4], x[5]
    hessian[2, 2] = f_zz
    hessian[2, 0] = 2.0 * u1 * f_zs + w2 * f_zq
    hessian[2, 1] = 2.0 * u2 * f_zs - w1 * f_zq
    hessian[2, 3] = 2.0 * w1 * f_zb - u2 * f_zq + wave[1] * f_zh
    hessian[2, 4] = 2.0 * w2 * f_zb + u1 * f_zq + wave[2] * f_zh
    hessian[2, 5] = 2.0 * w3 * f_zt
    for k in (0, 1, 3, 4, 5):
        hessian[k, 2] = hessian[2, k]
    hessian[0, 0] = 2.0 * f_s + w2 * w2 * f_qq
    hessian[1, 0] = -w1 * w2 * f_qq
    hessian[1, 1] = 2.0 * f_s + w1 * w1 * f_qq
    # of f_q, by w_1 and w_2
    along_1, along_2 = 2.0 * w1 * f_bq - u2 * f_qq, 2.0 * w2 * f_bq + u1 * f_qq
    hessian[3, 0] = 4.0 * f_bs * u1 * w1 + w2 * along_1 - f_m * w3
    hessian[4, 0] = 4.0 * f_bs * u1 * w2 + w2 * along_2 + f_q
    hessian[5, 0] = -f_m * w1
    hessian[3, 1] = 4.0 * f_bs * u2 * w1 - w1 * along_1 - f_q
    hessian[4, 1] = 4.0 * f_bs * u2 * w2 - w1 * along_2 - f_m * w3
    hessian[5, 1] = -f_m * w2
    # of f_b, by w_1 and w_2
    over_1 = 2.0 * w1 * f_bb - u2 * f_bq + wave[1] * f_bh
    over_2 = 2.0 * w2 * f_bb + u1 * f_bq + wave[2] * f_bh
    hessian[3, 3] = 2.0 * f_b + 2.0 * w1 * (over_1 + wave[1] * f_bh) - u2 * along_1 + f_h * wave[3]
    hessian[4, 3] = 2.0 * w2 * over_1 + u1 * along_1 + 2.0 * w1 * wave[2] * f_bh + f_h * wave[4]
    hessian[4, 4] = 2.0 * f_b + 2.0 * w2 * (over_2 + wave[2] * f_bh) + u1 * along_2 + f_h * wave[5]
    hessian[5, 3] = 4.0 * f_bt * w1 * w3 - f_m * u1
    hessian[5, 4] = 4.0 * f_bt * w2 * w3 - f_m * u2
    hessian[5, 5] = 2.0 * f_t
    for i, k in ((1, 0), (3, 0), (4, 0), (5, 0), (3, 1), (4, 1), (5, 1), (4, 3), (5, 3), (5, 4)):
        hessian[k, i] = hessian[i, k]


@kernel(allocates=True)
def basis(
    strains: Matrix, inverse_length: Vector, constants: Vector, values: Matrix, gradients: Blocks
) -> None:
    """Fill values (n, COEFFICIENTS) and gradients (n, 6, COEFFICIENTS) of every term, coefficient one.

    constants: (COLUMNS - Z_FROM,), those behind the limits.
    """
    count = values.shape[1]
    unit = np.zeros((1, COLUMNS))
    unit[0, Z_FROM:] = constants
    gradient = small_vector(6)
    none = small_matrix(0, 6)
    for i in range(strains.shape[0]):
        for k in range(count):
            unit[0, k] = 1.0
            values[i, k] = section_energy(unit, 0, strains[i], inverse_length[i], gradient, none)
            unit[0, k] = 0.0
            for r in range(6):
                gradients[i, r, k] = gradient[r]
