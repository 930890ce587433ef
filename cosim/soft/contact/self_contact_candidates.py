"""Which points of a film may come over which triangles: a list that serves until units have moved too far.

A point over a triangle by `self_contact_search` is the distance of its foot from it, room at most, and the
foot is no further from the triangle's bounding box than 2 b e, with e the longest edge and b the weight by
which a foot may lie beyond an edge. The list is made for more room by a margin m; it holds all such pairs
while no two units have moved against each other by m / (1 + 4 b) (`self_contact_motion`): point and foot, by
the weights of which b are negative, have come nearer by m at most. Units that are further from one another
than room and margin may move by that much more.
Boxes around some points of a face, and around some triangles of another, tell first which can be near.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple, final

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import INDEX_TABLE, INDICES, INTEGER, MATRIX, REAL, device_function, kernel
from cosim.soft.contact.self_contact_faces import FilmFaces, Relation
from cosim.soft.contact.self_contact_feet import fill_point
from cosim.soft.contact.self_contact_motion import BEYOND_EDGES, FEET_FOLLOW, UnitMotion

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

    nodes: IntArray
    weights: Array
    homes: IntArray
    triangles: IntArray
    films: IntArray
    relation: IntArray
    points_from: IntArray
    triangles_from: IntArray


_ROWS = types.NamedTuple(
    (INDEX_TABLE, MATRIX, INDEX_TABLE, INDEX_TABLE, INDEX_TABLE, INDEX_TABLE, INDICES, INDICES), _FilmRows
)


def _runs(face: IntArray, most: int) -> IntArray:
    """Return where runs of one face begin (k + 1,), none longer than `most`, and where the last one ends."""
    ends = [0, *(1 + np.flatnonzero(np.diff(face))).tolist(), len(face)]
    return np.array([*(k for a, b in pairwise(ends) for k in range(a, b, most)), len(face)], np.int64)


@kernel(REAL(MATRIX, INDEX_TABLE))
def _longest_edge(x: Array, triangles: IntArray) -> float:
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
def _share_nodes(nodes, corners):  # type: ignore[no-untyped-def]
    """Return whether a point and a triangle have a node in common."""
    for a in range(3):
        for b in range(3):
            if nodes[a] == corners[b]:
                return True
    return False


@device_function
def _enclose(boxes, begin, end, around):  # type: ignore[no-untyped-def]
    """Fill the box (6,), smallest and largest coordinates, around some boxes."""
    for r in range(3):
        around[r], around[3 + r] = np.inf, -np.inf
        for k in range(begin, end):
            around[r], around[3 + r] = min(around[r], boxes[k, r]), max(around[3 + r], boxes[k, 3 + r])


@device_function
def _square_between(boxes, k, x, y, z, u, v, w):  # type: ignore[no-untyped-def]
    """Return the squared distance of box k from that between the corners (x, y, z) and (u, v, w)."""
    along = max(boxes[k, 0] - u, x - boxes[k, 3], 0.0)
    across = max(boxes[k, 1] - v, y - boxes[k, 4], 0.0)
    beyond = max(boxes[k, 2] - w, z - boxes[k, 5], 0.0)
    return along * along + across * across + beyond * beyond


@device_function
def _fill_boxes(x, rows, points, triangles, bundles):  # type: ignore[no-untyped-def]
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
def _fill_near(rows, bundles, box, face, limit, near):  # type: ignore[no-untyped-def]
    """Fill which runs of triangles can meet a face's points in a box; return how many."""
    count, own = 0, (box[0], box[1], box[2], box[3], box[4], box[5])
    for k in range(bundles.shape[0]):
        other = rows.films[rows.triangles_from[k], 0]
        if rows.relation[face, other] != 0 and _square_between(bundles, k, *own) <= limit:
            near[count] = k
            count += 1
    return count


@device_function
def _list_point(rows, p, point, triangles, near, limit, listed, total):  # type: ignore[no-untyped-def]
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


@kernel(INTEGER(MATRIX, _ROWS, REAL, INDICES, INDICES), allocates=True)
def _fill_list(x, rows, room, first, listed):  # type: ignore[no-untyped-def]
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
