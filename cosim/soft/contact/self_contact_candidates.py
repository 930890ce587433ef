"""Which points of a film may come over which triangles: a list that serves until units have moved too far.

A point over a triangle by `self_contact_search` is the distance of its foot from it, room at most, and the
foot is no further from the triangle's bounding box than 2 b e, with e the longest edge and b the weight by
which a foot may lie beyond an edge. The list is made for more room by a margin m; it holds all such pairs
while no two units have moved against each other by m / (1 + 4 b) (`UnitMotion`): point and foot, by
the weights of which b are negative, have come nearer by m at most. Units that are further from one another
than room and margin may move by that much more.
Boxes around some points of a face, and around some triangles of another, tell first which can be near.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.

How far units of a film have moved against each other since an earlier shape of it.

Seen from one unit, turned and moved as its nodes have been in the mean, another may have gone a little way
though the film has been carried far. Any rotation bounds that motion; taken is the one of least squares.
Source: Kabsch, Acta Cryst. A 32 (1976) 922; by Newton's iteration for the polar factor, Higham, SIAM J. Sci.
Stat. Comput. 7 (1986) 1160.

Which candidates of a film are nearly over their triangle: a short list that serves for a small motion.

A foot within its triangle, of a point at a distance of up to R, was not far outside of it before point and
corners had moved by m against each other: the triangle's plane has turned by no more than 2 m / (h - 2 m),
with h its least height, and so

    M = (1 + 4 b) m + R 2 m / (h - 2 m)

in the plane, (1 + 4 b) m across; b is `BEYOND_EDGES`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import (
    IndexTable,
    Indices,
    Matrix,
    Vector,
    device_function,
    kernel,
    small_matrix,
    small_vector,
)
from cosim.soft.contact.point_kernels import fill_point, fill_slopes, plane_of
from cosim.soft.contact.self_contact_faces import FilmFaces, Relation

BEYOND_EDGES: Final = 0.02
"""Barycentric weight by which a foot may lie outside of a triangle: none slips through between two."""
FEET_FOLLOW: Final = 1.0 + 4.0 * BEYOND_EDGES
"""How far a foot moves at most, in a triangle whose corners move by no more than 1."""
_ITERATIONS_MAX = 30
_FLAT = 1e-9  # determinant of what is nearly singular: the rotation is not to be told


@kernel(allocates=True)
def furthest_from_mean(values: Matrix) -> float:
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
def _set_straight(turn: Matrix) -> None:
    for r in range(3):
        for c in range(3):
            turn[r, c] = 1.0 if r == c else 0.0


@device_function
def _make_rotation(turn: Matrix, minors: Matrix) -> None:
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
def _fit(
    x: Matrix,
    before: Matrix,
    nodes: Indices,
    begin: int,
    end: int,
    mean: Matrix,
    turn: Matrix,
    minors: Matrix,
) -> None:
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
def _deviation(
    x: Matrix, before: Matrix, nodes: Indices, begin: int, end: int, mean: Matrix, turn: Matrix
) -> float:
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


@kernel(allocates=True)
def _stay(x: Matrix, before: Matrix, nodes: Indices, start: Indices, allowed: Matrix, whole: float) -> bool:
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


_MARGIN_M = 4e-3  # more room lengthens the list, less makes it anew more often
_POINTS_OF_BOX, _TRIANGLES_OF_BOX = 16, 8  # neighbours in the numbering
_VALLEY = int(Relation.VALLEY)


class _FilmRows(NamedTuple):
    """Points and triangles of a film, and where their boxes begin.

    Args:
        nodes: (p, 3) that each point combines.
        weights: (p, 3).
        homes: (p, 2) face and unit of each point.
        triangles: (t, 3).
        films: (t, 2), face and unit of each.
        relation: (faces, faces), see `Relation`.
        points_from: (a + 1,), of each box the first point; those of one are of one face.
        triangles_from: (c + 1,), the same of triangles.
    """

    nodes: IndexTable
    weights: Matrix
    homes: IndexTable
    triangles: IndexTable
    films: IndexTable
    relation: IndexTable
    points_from: Indices
    triangles_from: Indices


def _runs(face: IntArray, most: int) -> IntArray:
    """Return where runs of one face begin (k + 1,), none longer than `most`, and where the last one ends."""
    ends = [0, *(1 + np.flatnonzero(np.diff(face))).tolist(), len(face)]
    return np.array([*(k for a, b in pairwise(ends) for k in range(a, b, most)), len(face)], np.int64)


@kernel
def _longest_edge(x: Matrix, triangles: IndexTable) -> float:
    """Return the length [m] of the longest edge."""
    most = 0.0
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b, square = triangles[t, k], triangles[t, (k + 1) % 3], 0.0
            for r in range(3):
                square += (x[a, r] - x[b, r]) ** 2
            most = max(most, square)
    return float(np.sqrt(most))


@device_function
def _share_nodes(nodes: Indices, corners: Indices) -> bool:
    """Return whether a point and a triangle have a node in common."""
    for a in range(3):
        for b in range(3):
            if nodes[a] == corners[b]:
                return True
    return False


@device_function
def _enclose(boxes: Matrix, begin: int, end: int, around: Vector) -> None:
    """Fill the box (6,), smallest and largest coordinates, around some boxes."""
    for r in range(3):
        around[r], around[3 + r] = np.inf, -np.inf
        for k in range(begin, end):
            around[r], around[3 + r] = min(around[r], boxes[k, r]), max(around[3 + r], boxes[k, 3 + r])


@device_function
def _square_between(
    boxes: Matrix, k: int, x: float, y: float, z: float, u: float, v: float, w: float
) -> float:
    """Return the squared distance of box k from that between the corners (x, y, z) and (u, v, w)."""
    along = max(boxes[k, 0] - u, x - boxes[k, 3], 0.0)
    across = max(boxes[k, 1] - v, y - boxes[k, 4], 0.0)
    beyond = max(boxes[k, 2] - w, z - boxes[k, 5], 0.0)
    return along * along + across * across + beyond * beyond


@device_function
def _fill_boxes(x: Matrix, rows: _FilmRows, points: Matrix, triangles: Matrix, bundles: Matrix) -> None:
    """Fill the boxes of all points, which have no size, of all triangles, and around those of each run."""
    for p in range(points.shape[0]):
        fill_point(x, rows.nodes[p], rows.weights[p], points[p])
        for r in range(3):
            points[p, 3 + r] = points[p, r]
    for t in range(triangles.shape[0]):
        a, b, c = rows.triangles[t, 0], rows.triangles[t, 1], rows.triangles[t, 2]
        for r in range(3):
            triangles[t, r] = min(x[a, r], x[b, r], x[c, r])
            triangles[t, 3 + r] = max(x[a, r], x[b, r], x[c, r])
    for k in range(bundles.shape[0]):
        _enclose(triangles, rows.triangles_from[k], rows.triangles_from[k + 1], bundles[k])


@device_function
def _fill_near(rows: _FilmRows, bundles: Matrix, box: Vector, face: int, limit: float, near: Indices) -> int:
    """Fill which runs of triangles can meet a face's points in a box; return how many."""
    count, own = 0, (box[0], box[1], box[2], box[3], box[4], box[5])
    for k in range(bundles.shape[0]):
        other = rows.films[rows.triangles_from[k], 0]
        if rows.relation[face, other] != 0 and _square_between(bundles, k, *own) <= limit:
            near[count] = k
            count += 1
    return count


@device_function
def _list_point(
    rows: _FilmRows,
    p: int,
    point: Vector,
    triangles: Matrix,
    near: Indices,
    limit: float,
    listed: Indices,
    total: int,
) -> int:
    """Add the triangles of a point to the list; return how many entries there are then."""
    x, y, z = point[0], point[1], point[2]
    for entry in range(near.shape[0]):
        begin, end = rows.triangles_from[near[entry]], rows.triangles_from[near[entry] + 1]
        # across a valley a point counts nothing that it hangs on
        valley = rows.relation[rows.homes[p, 0], rows.films[begin, 0]] == _VALLEY
        for t in range(begin, end):
            if _square_between(triangles, t, x, y, z, x, y, z) > limit:
                continue
            if valley and _share_nodes(rows.nodes[p], rows.triangles[t]):
                continue
            if total < listed.shape[0]:
                listed[total] = t
            total += 1
    return total


@kernel(allocates=True)
def _fill_list(x: Matrix, rows: _FilmRows, room: float, first: Indices, listed: Indices) -> int:
    """Fill each point's triangles, in ascending order; return how many there are.

    None are written beyond the room of the list.
    """
    points, triangles = np.empty((rows.nodes.shape[0], 6)), np.empty((rows.triangles.shape[0], 6))
    bundles, own = np.empty((rows.triangles_from.shape[0] - 1, 6)), np.empty(6)
    near, total, limit = np.empty(bundles.shape[0], np.int64), 0, room * room
    _fill_boxes(x, rows, points, triangles, bundles)
    for box in range(rows.points_from.shape[0] - 1):
        begin, end = rows.points_from[box], rows.points_from[box + 1]
        _enclose(points, begin, end, own)
        found = _fill_near(rows, bundles, own, rows.homes[begin, 0], limit, near)
        for p in range(begin, end):
            first[p] = total
            total = _list_point(rows, p, points[p], triangles, near[:found], limit, listed, total)
    first[rows.nodes.shape[0]] = total
    return total


@final
class FilmCandidates:
    """Keeps the list: triangles `listed[first[p]] .. listed[first[p + 1] - 1]` of point p, ascending.

    Args:
        faces: of the film.
        nodes: (p, 3) that each point combines.
        weights: (p, 3).
        home: (p, 2) face and unit of each point.
    """

    def __init__(self, faces: FilmFaces, nodes: IntArray, weights: Array, home: IntArray) -> None:
        self.films: IntArray = np.column_stack([faces.face, faces.unit])
        self.first: IntArray = np.zeros(len(nodes) + 1, np.int64)
        self.listed: IntArray = np.empty(8 * len(nodes), np.int64)
        points_from, triangles_from = _runs(home[:, 0], _POINTS_OF_BOX), _runs(faces.face, _TRIANGLES_OF_BOX)
        runs = points_from, triangles_from
        self._rows = _FilmRows(nodes, weights, home, faces.triangles, self.films, faces.relation, *runs)
        self.motion = UnitMotion(faces.unit_nodes, faces.units_meet)
        self._before: Array | None = None
        self._asked = 0.0
        self._allowed = np.empty((faces.units, faces.units))

    @property
    def near(self) -> Mask:
        """Units (u, u) of which the list may have pairs."""
        return np.asarray(self._allowed <= _MARGIN_M)

    def update(self, positions: Array, room_m: float) -> bool:
        """See to it that the list serves; return whether it was made anew.

        Args:
            positions: (n, 3) [m], of the nodes.
            room_m: largest distance of a point from a triangle that is asked for.
        """
        before = self._before
        if before is not None:
            allowed = (self._allowed - max(room_m - self._asked, 0.0)) / FEET_FOLLOW
            if self.motion.stays(positions, before, allowed):
                return False
        self._asked = room_m
        room = room_m + _MARGIN_M + self._make(positions, room_m + _MARGIN_M)
        self._allowed = _MARGIN_M + np.maximum(self.motion.gaps(positions) - room, 0.0)
        self._before = positions.copy()
        return True

    def _make(self, positions: Array, room_m: float) -> float:
        """Make the list; return how far a foot may be from the box of its triangle [m]."""
        beyond = 2.0 * BEYOND_EDGES * _longest_edge(positions, self._rows.triangles)
        while True:
            needed = _fill_list(positions, self._rows, room_m + beyond, self.first, self.listed)
            if needed <= len(self.listed):
                return beyond
            self.listed = np.empty(2 * needed, np.int64)


_MOTION_M = 0.3e-3  # more of it lengthens the list, less makes it anew more often
_MOST_OF_HEIGHT = 0.25  # where m is more of it, all that is near the plane is listed


@kernel
def measure_sides(x: Matrix, triangles: IndexTable, sides: Matrix) -> None:
    """Fill sides (t, 12): a corner of each triangle, its unit normal, slopes of the others' weights."""
    n, slope = small_vector(3), small_matrix(3, 3)
    for t in range(triangles.shape[0]):
        fill_slopes(x, triangles[t], n, plane_of(x, triangles[t], n), slope)
        for r in range(3):
            sides[t, r], sides[t, 3 + r] = x[triangles[t, 0], r], n[r]
            sides[t, 6 + r], sides[t, 9 + r] = slope[1, r], slope[2, r]


@device_function
def over_plane(side: Vector, x: float, y: float, z: float) -> float:
    """Return a point's distance from a triangle's plane."""
    x, y, z = x - side[0], y - side[1], z - side[2]
    return side[3] * x + side[4] * y + side[5] * z


@device_function
def over_side(side: Vector, x: float, y: float, z: float) -> tuple[float, float]:
    """Return a point's distance from a triangle's plane, and the least weight of its foot."""
    x, y, z = x - side[0], y - side[1], z - side[2]
    b, c = side[6] * x + side[7] * y + side[8] * z, side[9] * x + side[10] * y + side[11] * z
    return side[3] * x + side[4] * y + side[5] * z, min(1.0 - b - c, b, c)


@device_function
def _lowest_weight(side: Vector, motion: float, room: float) -> float:
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


@kernel(allocates=True)
def _shorten(
    sides: Matrix,
    place: Matrix,
    first: Indices,
    listed: Indices,
    room: float,
    behind: float,
    motion: float,
    start: Indices,
    kept: Indices,
) -> int:
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
