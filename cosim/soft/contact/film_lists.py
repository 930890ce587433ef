"""Neighbour lists of a film's points and triangles, valid until units have moved too far.

The long list has a margin m beyond the requested distance. It contains all pairs while no two units have
moved relative to each other by more than m / (1 + 4 b), b = `BEYOND_EDGES`: then point and foot, whose
weights may be as low as -b, have come nearer by m at most. Units beyond that distance may move by the extra
distance more. The short list is made from the long one, for a small motion m. A foot within its triangle, of
a point at distance d, was not far outside before that motion: the triangle's plane has rotated by an angle
whose sine is at most q = 2 m / (h - 2 m), with h its smallest height, so the foot has moved in the plane by
at most

    M = (1 + 4 b) m + (|d| + (1 + 4 b) m) q / sqrt(1 - q^2)

and across it by (1 + 4 b) m. Motions since both lists were built add up, so part of the long list's margin is
left to the short one, which alone is searched in most steps.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector, unchecked
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import triangle_foot
from cosim.soft.contact.self_contact_candidates import (
    BEYOND_EDGES,
    VALLEY,
    BoxRows,
    FilmRows,
    fill_list,
    foot_beside,
)
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints
from cosim.soft.contact.self_contact_search import ShortList, add_ascending, fill_over, measure_sides
from cosim.soft.contact.triangle_side import least_weight, measure_side, over_plane, steepest_slope
from cosim.soft.contact.unit_motion import (
    Allowance,
    Units,
    allow_motion,
    largest_deviation,
    least_remaining,
    store_shape,
    units_stay,
)

FEET_FOLLOW: Final = 1.0 + 4.0 * BEYOND_EDGES
"""Largest motion of a foot per motion of the triangle's corners."""
_MARGIN_M, _MARGIN_AT_REST_M = 4e-3, 0.5e-3
"""A larger margin makes the list longer, a smaller one shortens its life; states at rest differ much."""
_MOTION_M: Final = 0.3e-3  # motion for which a short list is built
_FURTHER_M: Final = 0.1e-3  # added to the distance for which a short list is built
_TOO_FAR_M: Final = 1e-3  # excess of a short list's distance above which it is rebuilt
_SEEN, _LISTED = 1, 2  # marks of a triangle: measured, in the short list


@device_function
def _fill_plane(x: Matrix, corners: Indices, lowest: Vector) -> None:
    """Fill a triangle's plane: normal, and its distance from the origin."""
    normal = lowest[:3]
    triangle_foot.plane_of(x, corners, normal)
    lowest[3] = 0.0
    for r in range(3):
        lowest[3] += normal[r] * x[corners[0], r]


@device_function
def _fill_lowest(side: Vector, lowest: Vector) -> None:
    """Fill the smallest weight of a foot outside a triangle that can come into it in a small motion.

    Entry 4 is for a point at zero distance, entry 5 is added per distance [1/m]. Narrow triangles rotate far.
    """
    across, steepest = FEET_FOLLOW * _MOTION_M, steepest_slope(side)
    sine = 2.0 * _MOTION_M * steepest / (1.0 - 2.0 * _MOTION_M * steepest)
    lowest[4], lowest[5] = -np.inf, 0.0
    if 0.0 <= sine < 1.0:
        lowest[5] = -steepest * sine / np.sqrt(1.0 - sine * sine)
        lowest[4] = -BEYOND_EDGES - across * steepest + across * lowest[5]


class LongList(NamedTuple):
    """Triangles near points, by boxes.

    Args:
        first: (p + 1,), start of each point's triangles in `listed`, in the order of the boxes.
        listed: triangles.
        place: (p,), index of each point in that order.
        lowest: (t, 6), see `_fill_plane` and `_fill_lowest`; scratch.
    """

    first: Indices
    listed: Indices
    place: Indices
    lowest: Matrix


@kernel
def shorten_list(
    x: Matrix, rows: FilmRows, long: LongList, reach: float, behind: float, short: ShortList
) -> tuple[int, int]:
    """Fill the short list with pairs that may come within the distances in front of or behind a triangle.

    Args:
        x: (n, 3) [m].
        rows: of the film.
        long: valid list.
        reach: largest distance in front of a triangle [m].
        behind: the same behind it [m].
        short: filled, with the sides of its triangles.

    Returns:
        Number of points, and of triangles, with an entry.
    """
    sides, count = short.sides, 0
    across, point, lowest, points = FEET_FOLLOW * _MOTION_M, small_vector(3), long.lowest, 0
    furthest = max(reach, behind) + across
    for t in range(sides.shape[0]):
        _fill_plane(x, rows.triangles[t], lowest[t])
        short.used[t] = 0
    for p in range(rows.nodes.shape[0]):
        short.first[p], begin, end = count, long.first[long.place[p]], long.first[long.place[p] + 1]
        nearest = np.inf
        if begin == end:
            continue
        triangle_foot.fill_point(x, rows.nodes[p], rows.weights[p], point)
        px, py, pz = point[0], point[1], point[2]
        for entry in range(begin, end):
            t = long.listed[entry]
            d = lowest[t, 0] * px + lowest[t, 1] * py + lowest[t, 2] * pz - lowest[t, 3]
            if not -behind - across <= d <= furthest:  # most are too far away
                continue
            if d > reach + across and rows.relation[rows.homes[p, 0], rows.films[t, 0]] == VALLEY:
                continue
            if short.used[t] == 0:
                short.used[t] = _SEEN
                measure_side(x, rows.triangles[t], sides[t])
                _fill_lowest(sides[t], lowest[t])
            if least_weight(sides[t], px, py, pz) >= lowest[t, 4] + lowest[t, 5] * abs(d):
                add_ascending(short, p, t, count)
                count, nearest = count + 1, min(nearest, d)
        if nearest > reach + across:  # triangles further in front count only if one is nearer or behind
            count = short.first[p]
        if count > short.first[p]:
            short.points[points], points = p, points + 1
        for entry in range(short.first[p], count):
            short.used[short.listed[entry]] = _LISTED
    short.first[rows.nodes.shape[0]], used = count, 0
    for t in range(sides.shape[0]):
        if short.used[t] == _LISTED:
            short.used[used] = t
            used += 1
    return points, used


@kernel
def fill_quiet(
    x: Matrix, rows: FilmRows, short: ShortList, points: int, bounds: tuple[float, float], quiet: Matrix
) -> None:
    """Lower the relative motions [m] in which no point gets over a triangle, for a list without such a point.

    They follow from a point's distance, or from the distance of its foot from the triangle: with s the
    steepest slope, M s in a motion m is at most m s (1.36 + 2.6 s |d|) if m s is at most 1/10.

    Args:
        x: (n, 3) [m], for which the list is valid.
        rows: of the film.
        short: list.
        points: number of points with an entry.
        bounds: largest distance in front of a triangle, and behind it [m].
        quiet: (u, u) [m], lowered.
    """
    point, (reach, behind) = small_vector(3), bounds
    for k in range(points):
        p = short.points[k]
        triangle_foot.fill_point(x, rows.nodes[p], rows.weights[p], point)
        for entry in range(short.first[p], short.first[p + 1]):
            t = short.listed[entry]
            a, b = min(rows.homes[p, 1], rows.films[t, 1]), max(rows.homes[p, 1], rows.films[t, 1])
            d = over_plane(short.sides[t], point[0], point[1], point[2])
            ahead = d + rows.spare[p] - reach
            if quiet[a, b] * FEET_FOLLOW > ahead:
                weight = least_weight(short.sides[t], point[0], point[1], point[2])
                steepest = steepest_slope(short.sides[t])
                beside = min((-BEYOND_EDGES - weight) / (1.36 + 2.6 * steepest * abs(d)), 0.1) / steepest
                free = max(max(ahead, -behind - d) / FEET_FOLLOW, beside)
                quiet[a, b] = min(quiet[a, b], max(free, 0.0))


@final
class FilmLists:
    """Finds points of a film over its triangles, by neighbour lists that are rebuilt when needed.

    Args:
        faces: of the film.
        points: of the film.
        body: its drawn nodes define groups of neighbouring points.
    """

    def __init__(self, faces: FilmFaces, points: FilmPoints, body: SoftBody) -> None:
        self.rows = FilmRows.of(faces, points)
        self.boxes = BoxRows.of(self.rows, body.positions)
        self.can_meet, self._meet = faces.can_meet, faces.units_meet
        units, nodes = faces.unit_nodes, body.nodes
        count, triangles = len(units), len(faces.triangles)
        self.units = Units(
            np.concatenate(units), np.cumsum([0, *map(len, units)], dtype=np.int64), np.empty(count),
            np.zeros((count, count)), np.empty((count, 5, 3)),
        )  # fmt: skip
        self.long, self.short, self._quiet = (Allowance.empty(nodes, count) for _ in range(3))
        first, listed = np.zeros(len(points) + 1, np.int64), np.empty(0, np.int64)
        self._long = LongList(first, listed, np.argsort(self.boxes.order), np.empty((triangles, 6)))
        self._short = ShortList.empty(len(points), triangles)
        self.hits = np.zeros((2 * len(points), 2), np.int64)
        self._seen, self._slack_m, self._entries = np.empty((nodes, 3)), 0.0, (0, 0)
        self._invalidate()

    def _invalidate(self) -> None:
        """Invalidate all lists."""
        self._long_m, self._short_m, self._quiet_m = -1.0, (-1.0, -1.0), (-1.0, -1.0)

    def over(self, x: Array, reach: float, behind: float, room_m: float, *, moves: bool) -> IntArray:
        """Return pairs (k, 2) of points over triangles, valid until the next search.

        Ascending by point, then by the triangle's unit.

        Args:
            x: (n, 3) [m].
            reach: largest distance in front of a triangle [m].
            behind: the same behind it [m].
            room_m: distance for which a new list is built, if the old one is not valid.
            moves: whether a new list should be valid for the next steps as well.
        """
        x = np.ascontiguousarray(x, dtype=float)
        self._update(x, reach, behind, room_m, moves)
        while (count := self._fill(x, reach, behind, self.hits)) > len(self.hits):
            self.hits = np.zeros((2 * count, 2), np.int64)
        return self.hits[:count]

    def presses(
        self, x: Array, reach: float, behind: tuple[float, float], room_m: float, *, moves: bool
    ) -> bool:
        """Return whether any point is over a triangle; if none is, store the motion for which that holds.

        Args:
            x: (n, 3) [m].
            reach: largest distance in front of a triangle [m].
            behind: the same behind it [m]: if no node is fast, and otherwise.
            room_m: distance for which a new list is built, if the old one is not valid.
            moves: whether a new list should be valid for the next steps as well.
        """
        x = np.ascontiguousarray(x, dtype=float)
        if self._stays_quiet(x, reach, behind[0]):
            return False
        self._update(x, reach, behind[1], room_m, moves)
        if self._fill(x, reach, behind[1], self.hits[:0]) > 0:
            return True
        self._store_quiet(x, reach, behind[1])
        return False

    def _fill(self, x: Array, reach: float, behind: float, out: IntArray) -> int:
        return int(unchecked(fill_over)(x, self.rows, self._short, self._entries[0], (reach, behind), out))

    def _update(self, x: Array, reach: float, behind: float, room_m: float, moves: bool) -> None:
        """Update the short list, and the sides of its triangles."""
        while not self._is_valid(x, reach, behind):
            self.make(x, room_m, moves)

    def _is_valid(self, x: Array, reach: float, behind: float) -> bool:
        """Return whether the short list is valid, after rebuilding it from a valid long one if needed."""
        in_reach = reach <= self._short_m[0] <= reach + _TOO_FAR_M and behind <= self._short_m[1]
        if in_reach and unchecked(units_stay)(x, self.units, self.short, 0.0):
            measure_sides(x, self.rows.triangles, self._short.used, self._entries[1], self._short.sides)
            return True
        further = reach + _FURTHER_M
        # units whose pairs are not in the long list may come nearer by the excess of their distance
        excess = max(max(further, behind) - self._long_m, 0.0) / FEET_FOLLOW
        if self._long_m < 0.0 or not unchecked(units_stay)(x, self.units, self.long, excess):
            return False
        self._entries = unchecked(shorten_list)(x, self.rows, self._long, further, behind, self._short)
        self._short_m = further, behind
        self.units.relative.fill(0.0)
        store_shape(x, self.units, self.short)
        return True

    def make(self, x: Array, room_m: float, moves: bool) -> None:
        """Build a new long list.

        Args:
            x: (n, 3) [m], of the nodes.
            room_m: largest distance of a point from a triangle.
            moves: whether it should be valid for the next steps as well.
        """
        margin = _MARGIN_M if moves else _MARGIN_AT_REST_M
        room = room_m + margin + foot_beside(x, self.rows.triangles)
        self._invalidate()
        self._list_around(x, room)
        margins = room, margin, _MOTION_M, FEET_FOLLOW
        allow_motion(x, self.units, self._meet, margins, self.long.allowed, self.short.allowed)
        store_shape(x, self.units, self.long)
        self._long_m = room_m

    def _list_around(self, x: Array, room_m: float) -> None:
        """Fill the long list with all pairs up to a distance."""
        long = self._long
        arguments = x, self.rows, self.boxes, (room_m, 0.0), long.first
        while (needed := fill_list(*arguments, long.listed)) > len(long.listed):
            room = needed + needed // 2
            self._long = long = long._replace(listed=np.empty(room, np.int64))
            self._short = self._short._replace(listed=np.empty(room, np.int64))

    def _stays_quiet(self, x: Array, reach: float, behind: float) -> bool:
        """Return whether still no point is over a triangle, by the result of `_store_quiet`.

        Usually no node has moved far from a common rigid motion since then: twice that distance bounds the
        relative motion of two units.
        """
        if not (reach <= self._quiet_m[0] and behind <= self._quiet_m[1]):
            return False
        if 2.0 * largest_deviation(x, self._seen, self.units.nodes) <= self._slack_m:
            return True
        if not unchecked(units_stay)(x, self.units, self._quiet, 0.0):
            return False
        self._slack_m = least_remaining(self._quiet.allowed, self.units.relative)
        np.copyto(self._seen, x)
        return True

    def _store_quiet(self, x: Array, reach: float, behind: float) -> None:
        """Store the relative motions [m] of units in which no point gets over a triangle."""
        relative, allowed = self.units.relative, self._quiet.allowed
        np.subtract(self.short.allowed, np.triu(relative) + np.triu(relative, 1).T, out=allowed)
        fill_quiet(x, self.rows, self._short, self._entries[0], (reach, behind), allowed)
        store_shape(x, self.units, self._quiet)
        self._quiet_m, self._slack_m = (reach, behind), -1.0
