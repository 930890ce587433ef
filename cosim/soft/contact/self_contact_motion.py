"""How far units of a film have moved against each other since an earlier shape of it.

Seen from one unit, turned and moved as its nodes have been in the mean, another may have gone a little way
though the film has been carried far. Any rotation bounds that motion; taken is the one of least squares.
Source: Kabsch, Acta Cryst. A 32 (1976) 922; by Newton's iteration for the polar factor, Higham, SIAM J. Sci.
Stat. Comput. 7 (1986) 1160.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import BOOLEAN, INDICES, MATRIX, REAL, device_function, kernel

BEYOND_EDGES: Final = 0.02
"""Barycentric weight by which a foot may lie outside of a triangle: none slips through between two."""
FEET_FOLLOW: Final = 1.0 + 4.0 * BEYOND_EDGES
"""How far a foot moves at most, in a triangle whose corners move by no more than 1."""
_ITERATIONS_MAX = 30
_FLAT = 1e-9  # determinant of what is nearly singular: the rotation is not to be told


@kernel(REAL(MATRIX), allocates=True)
def furthest_from_mean(values: Array) -> float:
    """Return how far from their mean the row of values (n, 3) is that is furthest from it."""
    mean, most = np.zeros(3), 0.0
    for n in range(values.shape[0]):
        for r in range(3):
            mean[r] += values[n, r] / values.shape[0]
    for n in range(values.shape[0]):
        square = 0.0
        for r in range(3):
            square += (values[n, r] - mean[r]) ** 2
        most = max(most, square)
    return float(np.sqrt(most))


@device_function
def _set_straight(turn):  # type: ignore[no-untyped-def]
    for r in range(3):
        for c in range(3):
            turn[r, c] = 1.0 if r == c else 0.0


@device_function
def _make_rotation(turn, minors):  # type: ignore[no-untyped-def]
    """Replace a matrix by the rotation nearest to it, by none where that is not to be told."""
    for _ in range(_ITERATIONS_MAX):
        size, area, determinant, change = 0.0, 0.0, 0.0, 0.0
        for r in range(3):
            a, b = (r + 1) % 3, (r + 2) % 3
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                minors[r, c] = turn[a, d] * turn[b, e] - turn[a, e] * turn[b, d]
                size, area = size + turn[r, c] * turn[r, c], area + minors[r, c] * minors[r, c]
            determinant += turn[r, 0] * minors[r, 0]
        if not determinant > _FLAT * size * np.sqrt(size):
            break
        scale = (area / size) ** 0.25 / np.sqrt(determinant)
        for r in range(3):
            for c in range(3):
                value = 0.5 * (scale * turn[r, c] + minors[r, c] / (scale * determinant))
                change, turn[r, c] = max(change, abs(value - turn[r, c])), value
        if change < 1e-13:
            return
    _set_straight(turn)


@device_function
def _fit(x, before, nodes, begin, end, mean, turn, minors):  # type: ignore[no-untyped-def]
    """Fill the means (2, 3) of some nodes, now and before, and the rotation between."""
    for r in range(3):
        mean[0, r] = mean[1, r] = 0.0
        for c in range(3):
            turn[r, c] = 0.0
    for k in range(begin, end):
        for r in range(3):
            mean[0, r] += x[nodes[k], r] / (end - begin)
            mean[1, r] += before[nodes[k], r] / (end - begin)
    for k in range(begin, end):
        for r in range(3):
            for c in range(3):
                turn[r, c] += (x[nodes[k], r] - mean[0, r]) * (before[nodes[k], c] - mean[1, c])
    _make_rotation(turn, minors)


@device_function
def _deviation(x, before, nodes, begin, end, mean, turn):  # type: ignore[no-untyped-def]
    """Return how far some nodes are at most from where the rigid motion takes them."""
    most = 0.0
    for k in range(begin, end):
        square, n = 0.0, nodes[k]
        u, v, w = before[n, 0] - mean[1, 0], before[n, 1] - mean[1, 1], before[n, 2] - mean[1, 2]
        for r in range(3):
            off = x[n, r] - mean[0, r] - turn[r, 0] * u - turn[r, 1] * v - turn[r, 2] * w
            square += off * off
        most = max(most, square)
    return np.sqrt(most)


@kernel(BOOLEAN(MATRIX, MATRIX, INDICES, INDICES, MATRIX, REAL), allocates=True)
def _stay(x, before, nodes, start, allowed, whole):  # type: ignore[no-untyped-def]
    """Return whether no two units have moved against each other by more than is allowed, or by the whole."""
    mean, turn, minors = np.empty((2, 3)), np.empty((3, 3)), np.empty((3, 3))
    units = start.shape[0] - 1
    for a in range(units):
        own = -1.0
        for b in range(a + 1, units):
            if not allowed[a, b] < whole:
                continue
            if own < 0.0:
                _fit(x, before, nodes, start[a], start[a + 1], mean, turn, minors)
                own = _deviation(x, before, nodes, start[a], start[a + 1], mean, turn)
            other = _deviation(x, before, nodes, start[b], start[b + 1], mean, turn)
            if not own + other <= allowed[a, b]:
                return False
    return True


@final
class UnitMotion:
    """Tells whether the units of a film have stayed where they were, seen from one another.

    Args:
        nodes: of each unit.
        meet: (u, u), which units can.
    """

    def __init__(self, nodes: Sequence[IntArray], meet: Mask) -> None:
        self._nodes: IntArray = np.concatenate(nodes)
        self._start: IntArray = np.cumsum([0, *map(len, nodes)], dtype=np.int64)
        self._meet = meet

    def gaps(self, positions: Array) -> Array:
        """Return how far units are at least from one another (u, u) [m]; infinite for those that never meet.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        x, first = positions[self._nodes], self._start[:-1]
        low, high = np.minimum.reduceat(x, first), np.maximum.reduceat(x, first)
        apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None])
        return np.where(self._meet, np.linalg.norm(np.maximum(apart, 0.0), axis=2), np.inf)

    def stays(self, positions: Array, before: Array, allowed_m: Array) -> bool:
        """Return whether no two units have moved against each other by more than what is allowed.

        The motion of two is what a node of the one has gone at most and one of the other, together, besides
        a rigid motion of both.

        Args:
            positions: (n, 3) [m], of the nodes.
            before: (n, 3) [m].
            allowed_m: (u, u) [m], symmetric.
        """
        whole = 2.0 * furthest_from_mean(positions - before)
        return bool(_stay(positions, before, self._nodes, self._start, allowed_m, whole))
