"""Cubic splines through points: polynomials with continuous second derivative. Their bits are those of
`scipy.interpolate.CubicSpline`, which takes a third of a second to load.
"""

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array


@final
class CubicSpline:
    """The cubic spline through points; it is extrapolated beyond its ends.

    With the slopes s of the ends given, the others solve, with distances h and slopes m of the chords,
    h[i] s[i-1] + 2 (h[i-1] + h[i]) s[i] + h[i-1] s[i+1] = 3 (h[i] m[i-1] + h[i-1] m[i]). Where they are not
    given, the third derivative is continuous at the points next to the ends ("not a knot").

    Args:
        x: (n,) increasing, n >= 2.
        y: (n, ...) values.
        slopes: at both ends, numbers or (...); None for "not a knot".

    Attributes:
        x: (n,)
        c: (4, n - 1, ...) coefficients of the cubes first, in x minus the start of each piece.
    """

    def __init__(self, x: Array, y: Array, slopes: tuple[Array | float, Array | float] | None = None) -> None:
        self.x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        h = np.diff(self.x).reshape(-1, *[1] * (y.ndim - 1))
        chord = np.diff(y, axis=0) / h
        if slopes is None and len(self.x) == 2:
            slopes = chord[0], chord[0]
        slope = _slopes(self.x, h, chord, slopes)
        bend = (slope[:-1] + slope[1:] - 2 * chord) / h
        self.c = np.stack([bend / h, (chord - slope[:-1]) / h - bend, slope[:-1], y[:-1]])

    def __call__(self, x: Array | Sequence[float] | float, order: int = 0) -> Array:
        """Return values, or derivatives of an order up to 3, at places of any shape."""
        place = np.asarray(x, dtype=float)
        piece = np.clip(np.searchsorted(self.x, place, side="right") - 1, 0, len(self.x) - 2)
        offset = (place - self.x[piece]).reshape(place.shape + (1,) * (self.c.ndim - 2))
        result, power = np.zeros(()), np.ones(())
        for exponent in range(order, 4):
            factor = float(np.prod(range(exponent - order + 1, exponent + 1)))
            result = result + self.c[3 - exponent, piece] * power * factor
            power = power * offset
        return result


def _slopes(x: Array, h: Array, chord: Array, ends: tuple[Array | float, Array | float] | None) -> Array:
    """Return the slopes (n, ...) at the points."""
    from scipy.linalg import solve, solve_banded  # imported here because it takes long to load

    n, d = len(x), h.reshape(-1)
    right = np.empty((n, *chord.shape[1:]))
    if ends is None and n == 3:  # a parabola
        right[0], right[2] = 2 * chord[0], 2 * chord[1]
        right[1] = 3 * (h[0] * chord[1] + h[1] * chord[0])
        matrix = np.array([[1, 1, 0], [d[1], 2 * (d[0] + d[1]), d[0]], [0, 1, 1]])
        return np.asarray(solve(matrix, right.reshape(n, -1), check_finite=False)).reshape(right.shape)
    above, diagonal, below = bands = np.zeros((3, n))
    diagonal[1:-1], above[2:], below[:-2] = 2 * (d[:-1] + d[1:]), d[:-1], d[1:]
    right[1:-1] = 3 * (h[1:] * chord[:-1] + h[:-1] * chord[1:])
    if ends is not None:
        diagonal[[0, -1]], right[0], right[-1] = 1, *ends
    else:
        diagonal[0], above[1] = d[1], x[2] - x[0]
        diagonal[-1], below[-2] = d[-2], x[-1] - x[-3]
        span = above[1]
        right[0] = ((h[0] + 2 * span) * h[1] * chord[0] + h[0] ** 2 * chord[1]) / span
        span = below[-2]
        right[-1] = (h[-1] ** 2 * chord[-2] + (2 * span + h[-1]) * h[-2] * chord[-1]) / span
    return np.asarray(solve_banded((1, 1), bands, right.reshape(n, -1), check_finite=False)).reshape(
        right.shape
    )
