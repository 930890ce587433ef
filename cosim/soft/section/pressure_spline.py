"""Uniform cubic B-splines over pressure, fine where a film changes most: near zero.

q = arsinh(p / p_0); c(p) = sum_k B_k(q) c_k. Source: de Boor, A Practical Guide to Splines, chapter IX.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar, final

import numpy as np

from cosim.frames import Array

_SCALE_Pa = 200.0
T = TypeVar("T", float, Array)


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
        inside = min(max(pressure_Pa, 0.0), self.largest_Pa)
        span = math.asinh(self.largest_Pa / _SCALE_Pa) / self.intervals
        place = math.asinh(inside / _SCALE_Pa) / span
        first = min(int(place), self.intervals - 1)
        values, slopes = _cubics(place - first)
        slope = 1.0 / (span * math.hypot(inside, _SCALE_Pa))
        result = np.zeros((2, self.size))
        result[0, first : first + 4] = values
        result[1, first : first + 4] = [slope * value for value in slopes]
        result[0] += (pressure_Pa - inside) * result[1]
        return result

    def bases(self, pressure_Pa: Array) -> Array:
        """Return `basis` of many pressures (k,) [Pa]: (k, 2, size)."""
        inside = np.clip(pressure_Pa, 0.0, self.largest_Pa)
        span = math.asinh(self.largest_Pa / _SCALE_Pa) / self.intervals
        place = np.arcsinh(inside / _SCALE_Pa) / span
        first = np.minimum(place.astype(np.int64), self.intervals - 1)
        values, slopes = _cubics(place - first)
        result = np.zeros((len(inside), 2, self.size))
        rows, columns = np.arange(len(inside))[:, None], first[:, None] + np.arange(4)
        result[rows, 0, columns] = np.stack(values, axis=1)
        result[rows, 1, columns] = np.stack(slopes, axis=1) / (span * np.hypot(inside, _SCALE_Pa))[:, None]
        result[:, 0] += (pressure_Pa - inside)[:, None] * result[:, 1]
        return result


def _cubics(u: T) -> tuple[tuple[T, T, T, T], tuple[T, T, T, T]]:
    """Return the four functions on an interval and their slopes by u, at a place u (0 to 1) in it."""
    v = 1.0 - u
    return (
        (
            v**3 / 6.0,
            (3.0 * u**3 - 6.0 * u * u + 4.0) / 6.0,
            (3.0 * v**3 - 6.0 * v * v + 4.0) / 6.0,
            u**3 / 6.0,
        ),
        (-0.5 * v * v, (1.5 * u - 2.0) * u, (2.0 - 1.5 * v) * v, 0.5 * u * u),
    )
