"""Uniform cubic B-splines over pressure, fine where a film changes most: near zero.

q = arsinh(p / p_0); c(p) = sum_k B_k(q) c_k. Source: de Boor, A Practical Guide to Splines, chapter IX.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numba import int64, void

from cosim.base.frames import Array
from cosim.base.kernels import BLOCKS, MATRIX, REAL, VECTOR, device_function, kernel, small_matrix

_SCALE_Pa = 200.0
TERMS = 4
"""Functions that differ from zero at a pressure, at most."""


@device_function
def _cubics(u, out):  # type: ignore[no-untyped-def]
    v = 1.0 - u
    out[0] = v * v * v / 6.0
    out[1] = (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0
    out[2] = (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0
    out[3] = u * u * u / 6.0


@kernel(int64(REAL, REAL, int64, MATRIX), taken_in=True)
def active_terms(pressure: float, largest: float, intervals: int, out: Array) -> int:
    """Fill out (2, TERMS): values and slopes d/dp [1/Pa] of the functions that are not zero.

    Returns the first of them. Beyond 0 to `largest` the functions go on as straight lines in p.
    """
    # a pressure that is not a number gives such weights, and a place that exists
    inside = largest if pressure > largest else pressure if pressure > 0.0 else 0.0
    span = math.asinh(largest / _SCALE_Pa) / intervals
    place = math.asinh(inside / _SCALE_Pa) / span
    first = min(int(place), intervals - 1)
    u = place - first
    v = 1.0 - u
    slope = 1.0 / (6.0 * span * math.sqrt(inside * inside + _SCALE_Pa * _SCALE_Pa))
    _cubics(u, out[0])
    out[1, 0] = -3.0 * slope * v * v
    out[1, 1] = slope * (9.0 * u * u - 12.0 * u)
    out[1, 2] = slope * (-9.0 * v * v + 12.0 * v)
    out[1, 3] = 3.0 * slope * u * u
    for k in range(4):
        out[0, k] += (pressure - inside) * out[1, k]
    return first


@kernel(void(VECTOR, REAL, int64, BLOCKS))
def fill_bases(pressures: Array, largest: float, intervals: int, out: Array) -> None:
    """Put the active terms of pressures (k,) in their places in out (k, 2, size)."""
    terms = small_matrix(2, TERMS)
    for p in range(pressures.shape[0]):
        first = active_terms(pressures[p], largest, intervals, terms)
        for k in range(TERMS):
            out[p, 0, first + k] = terms[0, k]
            out[p, 1, first + k] = terms[1, k]


@kernel(void(MATRIX, int64, VECTOR, VECTOR), taken_in=True)
def weighted_rows(table: Array, first: int, weights: Array, out: Array) -> None:
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

    def slopes(self, table: Array, out: Array) -> None:
        """Fill out (m,) with their slopes d/dp."""
        weighted_rows(table, self.first, self.weights[1], out)


@final
@dataclass(frozen=True)
class PressureSpline:
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
        fill_bases(pressure_Pa, self.largest_Pa, self.intervals, result)
        return result

    def terms(self, pressure_Pa: float) -> SplineTerms:
        """Return the functions that are not zero at a pressure."""
        weights = np.empty((2, TERMS))
        first = active_terms(pressure_Pa, self.largest_Pa, self.intervals, weights)
        return SplineTerms(first, weights)
