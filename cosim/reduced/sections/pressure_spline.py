"""Uniform cubic B-splines over pressure, fine near zero, where a film changes most: q = arsinh(p / p_0), c(p)
= sum_k B_k(q) c_k. Source: de Boor, A Practical Guide to Splines, chapter IX.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import kernel, small_matrix

_SCALE_Pa = 200.0
TERMS = 4
"""Largest number of functions that are not zero at a pressure."""


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

        Beyond the range the functions are linear in p.
        """
        values_and_slopes, terms = np.zeros((2, self.size)), np.empty((2, TERMS))
        first = active_terms(pressure_Pa, self, terms)
        values_and_slopes[:, first : first + TERMS] = terms
        return values_and_slopes

    def fill(self, pressure_Pa: float, table: Array, out: Array) -> None:
        """Fill out (m,) with the values of splines of coefficients (size, m) at a pressure."""
        spline_values(self, pressure_Pa, table, out)


@kernel
def active_terms(pressure: float, spline: PressureSpline, out: Matrix) -> int:
    """Fill out (2, TERMS): values and slopes d/dp [1/Pa] of the functions that are not zero.

    Returns the index of the first of them. Beyond 0 to the largest pressure they are linear in p.
    """
    # a NaN pressure gives NaN weights and a valid index
    largest, intervals = spline.largest_Pa, spline.intervals
    inside = largest if pressure > largest else pressure if pressure > 0.0 else 0.0
    span = math.asinh(largest / _SCALE_Pa) / intervals
    position = math.asinh(inside / _SCALE_Pa) / span
    first = min(int(position), intervals - 1)
    u = position - first
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
