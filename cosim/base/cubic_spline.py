"""Cubic splines through points, with their first two derivatives.

Those of scipy do the same; to load them, with all that they bring along, takes a tenth of a run's start.
"""

from __future__ import annotations

from typing import final

import numpy as np
from scipy.linalg.lapack import dgtsv

from cosim.base.frames import Array


@final
class CubicSpline:
    """The curve through points that is cubic between them, and smooth up to its second derivative.

    Between two points, with h their distance, t the way behind the first, m = (y1 - y0) / h, slopes s and
    r = (s0 + s1 - 2 m) / h, the curve is y0 + s0 t + ((m - s0) / h - r) t^2 + r t^3 / h. Its second
    derivative is the same on either side of a point for h1 s0 + 2 (h0 + h1) s1 + h0 s2 = 3 (h1 m0 + h0 m1).
    Without slopes at the ends, the first two pieces are one cubic, and the last two; two points make a line,
    three a parabola. Beyond its ends the curve goes on as its first or last piece (de Boor, A Practical Guide
    to Splines, chapter IV).

    Args:
        places: (n,), increasing; at least two.
        values: (n, ...).
        slopes: (2, ...), dy/dx at both ends; None: none are given.
    """

    def __init__(self, places: Array, values: Array, slopes: Array | None = None) -> None:
        self.places = places
        rows = values.reshape(len(places), -1)
        h = np.diff(places)[:, None]
        m = np.diff(rows, axis=0) / h
        s = _slopes(places, h, m, None if slopes is None else slopes.reshape(2, -1))
        r = (s[:-1] + s[1:] - 2.0 * m) / h
        powers = np.stack([rows[:-1], s[:-1], (m - s[:-1]) / h - r, r / h])
        self.powers = powers.reshape(4, len(h), *values.shape[1:])

    def __call__(self, place: float | Array, order: int = 0) -> Array:
        """Return the curve (..., ...) at places (...,), or its first or second derivative."""
        return self.with_derivatives(place)[order]

    def with_derivatives(self, place: float | Array) -> tuple[Array, Array, Array]:
        """Return the curve (..., ...) at places (...,), its first and its second derivative."""
        k = np.searchsorted(self.places[1:-1], place, side="right")
        t = np.asarray(place - self.places[k]).reshape((*np.shape(place), *[1] * (self.powers.ndim - 2)))
        value, slope, curve, twist = self.powers[:, k]
        square = t * t
        return (
            np.asarray(value + slope * t + curve * square + twist * (square * t)),
            np.asarray(slope + curve * t * 2.0 + twist * square * 3.0),
            np.asarray(curve * 2.0 + twist * t * 6.0),
        )


def _slopes(places: Array, h: Array, m: Array, ends: Array | None) -> Array:
    """Return slopes (n, k) at n points, of which steps (n - 1, 1) and mean slopes (n - 1, k) are known."""
    below, on, above = np.ones(len(h)), np.ones(len(h) + 1), np.ones(len(h))
    right = np.empty((len(h) + 1, m.shape[1]))
    below[:-1], on[1:-1], above[1:] = h[1:, 0], 2.0 * (h[:-1] + h[1:])[:, 0], h[:-1, 0]
    right[1:-1] = 3.0 * (h[1:] * m[:-1] + h[:-1] * m[1:])
    if ends is not None or len(h) == 1:  # two points make a line
        below[-1] = above[0] = 0.0
        right[[0, -1]] = m if ends is None else ends
    elif len(h) == 2:  # a parabola
        right[[0, -1]] = 2.0 * m
    else:
        on[0], above[0], right[0] = _one_cubic(places[2] - places[0], *h[:2, 0], *m[:2])
        on[-1], below[-1], right[-1] = _one_cubic(places[-1] - places[-3], *h[:-3:-1, 0], *m[:-3:-1])
    return np.asarray(dgtsv(below, on, above, right)[3])


def _one_cubic(both: float, h0: float, h1: float, m0: Array, m1: Array) -> tuple[float, float, Array]:
    """Return a and b, c of a s0 + b s1 = c: the two pieces at an end have the same third derivative."""
    return h1, both, ((h0 + 2.0 * both) * h1 * m0 + h0**2 * m1) / both
