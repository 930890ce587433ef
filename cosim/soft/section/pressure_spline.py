"""Uniform cubic B-splines over pressure, fine where a film changes most: near zero.

q = arsinh(p / p_0); c(p) = sum_k B_k(q) c_k. Source: de Boor, A Practical Guide to Splines, chapter IX.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.frames import Array

_SCALE_Pa = 200.0


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
        u = place - first
        v = 1.0 - u
        slope = 1.0 / (span * math.hypot(inside, _SCALE_Pa))
        values = (v**3, 3.0 * u**3 - 6.0 * u * u + 4.0, 3.0 * v**3 - 6.0 * v * v + 4.0, u**3)
        slopes = (-3.0 * v * v, 9.0 * u * u - 12.0 * u, -9.0 * v * v + 12.0 * v, 3.0 * u * u)
        result = np.zeros((2, self.size))
        result[0, first : first + 4] = [value / 6.0 for value in values]
        result[1, first : first + 4] = [slope * value / 6.0 for value in slopes]
        result[0] += (pressure_Pa - inside) * result[1]
        return result
