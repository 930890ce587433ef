"""Cubic splines through points: polynomials with continuous second derivative. They are those of
`scipy.interpolate.CubicSpline` up to rounding; SciPy takes a third of a second to load.
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
    n, d = len(x), h.reshape(-1)
    right = np.empty((n, *chord.shape[1:]))
    above, diagonal, below = np.zeros((3, n))  # of row i in columns i + 1, i and i - 1
    diagonal[1:-1], above[1:-1], below[1:-1] = 2 * (d[:-1] + d[1:]), d[:-1], d[1:]
    right[1:-1] = 3 * (h[1:] * chord[:-1] + h[:-1] * chord[1:])
    if ends is not None:
        diagonal[[0, -1]], right[0], right[-1] = 1, *ends
    elif n == 3:  # a parabola
        diagonal[[0, -1]] = above[0] = below[-1] = 1
        right[0], right[-1] = 2 * chord[0], 2 * chord[1]
    else:
        diagonal[0], above[0] = d[1], x[2] - x[0]
        diagonal[-1], below[-1] = d[-2], x[-1] - x[-3]
        span = above[0]
        right[0] = ((h[0] + 2 * span) * h[1] * chord[0] + h[0] ** 2 * chord[1]) / span
        span = below[-1]
        right[-1] = (h[-1] ** 2 * chord[-2] + (2 * span + h[-1]) * h[-2] * chord[-1]) / span
    return _tridiagonal_solution(below.tolist(), diagonal.tolist(), above.tolist(), right)


def _tridiagonal_solution(below: list[float], diagonal: list[float], above: list[float], x: Array) -> Array:
    """Return the solution of a tridiagonal system, by elimination with exchanges of successive rows.

    In place of the right side x (n, ...). SciPy's solver would take longer to load than all splines of a run.
    """
    last, beyond = len(x) - 1, [0.0] * len(x)
    for i in range(last):
        j = i + 1
        if abs(diagonal[i]) >= abs(below[j]):
            factor = below[j] / diagonal[i]
            diagonal[j] -= factor * above[i]
            x[j] -= factor * x[i]
            continue
        factor, diagonal[i] = diagonal[i] / below[j], below[j]
        diagonal[j], above[i] = above[i] - factor * diagonal[j], diagonal[j]
        beyond[i], above[j] = above[j], -factor * above[j]
        x[i], x[j] = x[j].copy(), x[i] - factor * x[j]
    x[last] /= diagonal[last]
    for i in range(last - 1, -1, -1):
        known = above[i] * x[i + 1] + (beyond[i] * x[i + 2] if beyond[i] else 0.0)
        x[i] = (x[i] - known) / diagonal[i]
    return x
