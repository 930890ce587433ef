"""Which candidates of a film are nearly over their triangle: a short list that serves for a small motion.

A foot within its triangle, of a point at a distance of up to R, was not far outside of it before point and
corners had moved by m against each other: the triangle's plane has turned by no more than 2 m / (h - 2 m),
with h its least height, and so

    M = (1 + 4 b) m + R 2 m / (h - 2 m)

in the plane, (1 + 4 b) m across; b is `BEYOND_EDGES`.
"""

from __future__ import annotations

from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import INDEX_TABLE, INDICES, INTEGER, MATRIX, REAL, device_function, kernel
from cosim.base.small_arrays import small_matrix, small_vector
from cosim.soft.contact.self_contact_feet import fill_slopes, plane_of
from cosim.soft.contact.self_contact_motion import BEYOND_EDGES, FEET_FOLLOW, UnitMotion

_MOTION_M = 0.3e-3  # more of it lengthens the list, less makes it anew more often
_MOST_OF_HEIGHT = 0.25  # where m is more of it, all that is near the plane is listed


@kernel((MATRIX, INDEX_TABLE, MATRIX))
def measure_sides(x, triangles, sides):  # type: ignore[no-untyped-def]
    """Fill sides (t, 12): a corner of each triangle, its unit normal, slopes of the others' weights."""
    n, slope = small_vector(3), small_matrix(3, 3)
    for t in range(triangles.shape[0]):
        fill_slopes(x, triangles[t], n, plane_of(x, triangles[t], n), slope)
        for r in range(3):
            sides[t, r], sides[t, 3 + r] = x[triangles[t, 0], r], n[r]
            sides[t, 6 + r], sides[t, 9 + r] = slope[1, r], slope[2, r]


@device_function
def over_plane(side, x, y, z):  # type: ignore[no-untyped-def]
    """Return a point's distance from a triangle's plane."""
    x, y, z = x - side[0], y - side[1], z - side[2]
    return side[3] * x + side[4] * y + side[5] * z


@device_function
def over_side(side, x, y, z):  # type: ignore[no-untyped-def]
    """Return a point's distance from a triangle's plane, and the least weight of its foot."""
    x, y, z = x - side[0], y - side[1], z - side[2]
    b, c = side[6] * x + side[7] * y + side[8] * z, side[9] * x + side[10] * y + side[11] * z
    return side[3] * x + side[4] * y + side[5] * z, min(1.0 - b - c, b, c)


@device_function
def _lowest_weight(side, motion, room):  # type: ignore[no-untyped-def]
    """Return the weight above which a foot may come into its triangle."""
    steepest = 0.0
    first, second, both = 0.0, 0.0, 0.0
    for r in range(6, 9):
        first, second = first + side[r] * side[r], second + side[3 + r] * side[3 + r]
        both += (side[r] + side[3 + r]) ** 2
    steepest = np.sqrt(max(first, second, both))  # 1 / h
    if not motion * steepest < _MOST_OF_HEIGHT:
        return -np.inf
    along = FEET_FOLLOW * motion + room * 2.0 * motion * steepest / (1.0 - 2.0 * motion * steepest)
    return -BEYOND_EDGES - along * steepest


@kernel(INTEGER(MATRIX, MATRIX, INDICES, INDICES, REAL, REAL, REAL, INDICES, INDICES), allocates=True)
def _shorten(sides, place, first, listed, room, behind, motion, start, kept):  # type: ignore[no-untyped-def]
    """Fill what is kept of the list of each point; return how many there are."""
    count, across = 0, FEET_FOLLOW * motion
    lowest = np.empty(sides.shape[0])
    for t in range(sides.shape[0]):
        lowest[t] = _lowest_weight(sides[t], motion, room + across)
    for p in range(place.shape[0]):
        start[p] = count
        for entry in range(first[p], first[p + 1]):
            t = listed[entry]
            d = over_plane(sides[t], place[p, 0], place[p, 1], place[p, 2])  # which most are too far from
            if not -behind - across <= d <= room + across:
                continue
            _, weight = over_side(sides[t], place[p, 0], place[p, 1], place[p, 2])
            if weight >= lowest[t]:
                kept[count] = t
                count += 1
    start[place.shape[0]] = count
    return count


@final
class ShortList:
    """Keeps the list: triangles `listed[first[p]] .. listed[first[p + 1] - 1]` of point p, ascending.

    Args:
        motion: of the film's units.
        points: how many there are.
    """

    def __init__(self, motion: UnitMotion, points: int) -> None:
        self._motion = motion
        self.first: IntArray = np.zeros(points + 1, np.int64)
        self.listed: IntArray = np.empty(0, np.int64)
        self._before: Array | None = None
        self._allowed = np.empty(0)
        self._room = self._behind = 0.0

    def serves(self, positions: Array, room_m: float, behind_m: float) -> bool:
        """Return whether it holds all that may be over a triangle, as long as the candidates do.

        Args:
            positions: (n, 3) [m], of the nodes.
            room_m: largest distance in front of a triangle that is asked for.
            behind_m: the same behind it.
        """
        if self._before is None or room_m > self._room or behind_m > self._behind:
            return False
        return self._motion.stays(positions, self._before, self._allowed)

    def make(
        self, positions: Array, place: Array, sides: Array, candidates: tuple[IntArray, IntArray], near: Mask,
        room_m: float, behind_m: float,
    ) -> None:  # fmt: skip
        """Make it of candidates.

        Args:
            positions: (n, 3) [m], of the nodes.
            place: (p, 3) [m], of the points.
            sides: (t, 12), see `measure_sides`.
            candidates: where those of each point begin, and their triangles.
            near: (u, u), units of which there may be some.
            room_m: as in `serves`.
            behind_m: the same.
        """
        first, listed = candidates
        if len(self.listed) < first[-1]:
            self.listed = np.empty_like(listed)
        _shorten(sides, place, first, listed, room_m, behind_m, _MOTION_M, self.first, self.listed)
        self._room, self._behind, self._before = room_m, behind_m, positions.copy()
        self._allowed = np.where(near, _MOTION_M, np.inf)
