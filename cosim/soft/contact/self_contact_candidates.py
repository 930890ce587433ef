"""Which points of a film may come over which triangles: a list that serves until units have moved too far.

A point over a triangle by `self_contact_search` is the distance of its foot from it, room at most, and the
foot is no further from the triangle's bounding box than 2 b e, with e the longest edge and b the weight by
which a foot may lie beyond an edge. The list is made for more room by a margin m; it holds all such pairs
while no two units have moved against each other by m / (1 + 4 b) (`self_contact_motion`): point and foot, by
the weights of which b are negative, have come nearer by m at most. Units that are further from one another
than room and margin may move by that much more.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from __future__ import annotations

from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import INDEX_TABLE, INDICES, INTEGER, MATRIX, REAL, VECTOR, device_function, kernel
from cosim.soft.contact.self_contact_faces import FilmFaces, Relation
from cosim.soft.contact.self_contact_motion import BEYOND_EDGES, FEET_FOLLOW, UnitMotion

_MARGIN_M = 4e-3  # more room lengthens the list, less makes it anew more often
_CELLS_MAX = 48  # along each axis
_VALLEY = int(Relation.VALLEY)


@kernel((MATRIX, INDEX_TABLE, VECTOR), allocates=True)
def _measure(x: Array, triangles: IntArray, out: Array) -> None:
    """Fill smallest coordinates (3), largest (3), mean longest side of a triangle's box, longest edge."""
    out[:3], out[3:6], out[6:] = np.inf, -np.inf, 0.0
    for n in range(x.shape[0]):
        for r in range(3):
            out[r], out[3 + r] = min(out[r], x[n, r]), max(out[3 + r], x[n, r])
    for t in range(triangles.shape[0]):
        side = 0.0
        for k in range(3):
            square, a, b = 0.0, triangles[t, k], triangles[t, (k + 1) % 3]
            for r in range(3):
                along = abs(x[a, r] - x[b, r])
                side, square = max(side, along), square + along * along
            out[7] = max(out[7], square)
        out[6] += side / triangles.shape[0]
    out[7] = np.sqrt(out[7])


@device_function
def _cell(value, low, size, count):  # type: ignore[no-untyped-def]
    return min(max(int((value - low) / size), 0), count - 1)


@kernel(INTEGER(MATRIX, INDEX_TABLE, VECTOR, REAL, INDICES, REAL, INDICES, INDICES), allocates=True)
def _fill_grid(x, triangles, low, size, counts, room, start, entries):  # type: ignore[no-untyped-def]
    """Fill the triangles of each cell; return how many entries that takes (none are written beyond the room).

    Cell c holds entries[start[c]] .. entries[start[c + 1] - 1].
    """
    span = np.empty((triangles.shape[0], 6), np.int64)
    start[:] = 0
    for t in range(triangles.shape[0]):
        for r in range(3):
            a, b, c = x[triangles[t, 0], r], x[triangles[t, 1], r], x[triangles[t, 2], r]
            span[t, r] = _cell(min(a, b, c) - room, low[r], size, counts[r])
            span[t, 3 + r] = _cell(max(a, b, c) + room, low[r], size, counts[r])
        for i in range(span[t, 0], span[t, 3] + 1):
            for j in range(span[t, 1], span[t, 4] + 1):
                for k in range(span[t, 2], span[t, 5] + 1):
                    start[(i * counts[1] + j) * counts[2] + k + 1] += 1
    for c in range(start.shape[0] - 1):
        start[c + 1] += start[c]
    total = start[start.shape[0] - 1]
    if total > entries.shape[0]:
        return total
    for t in range(triangles.shape[0] - 1, -1, -1):
        for i in range(span[t, 0], span[t, 3] + 1):
            for j in range(span[t, 1], span[t, 4] + 1):
                for k in range(span[t, 2], span[t, 5] + 1):
                    cell = (i * counts[1] + j) * counts[2] + k + 1
                    start[cell] -= 1
                    entries[start[cell]] = t
    for c in range(start.shape[0] - 1):
        start[c] = start[c + 1]
    start[start.shape[0] - 1] = total
    return total


@device_function
def _share_nodes(nodes, corners):  # type: ignore[no-untyped-def]
    """Return whether a point and a triangle have a node in common."""
    for a in range(3):
        for b in range(3):
            if nodes[a] == corners[b]:
                return True
    return False


@device_function
def _square_to_box(y, a, b, c):  # type: ignore[no-untyped-def]
    """Return the squared distance of a point from the bounding box of three others."""
    square = 0.0
    for r in range(3):
        beyond = max(min(a[r], b[r], c[r]) - y[r], y[r] - max(a[r], b[r], c[r]), 0.0)
        square += beyond * beyond
    return square


@kernel(
    INTEGER(
        MATRIX, INDEX_TABLE, MATRIX, INDEX_TABLE, INDEX_TABLE, INDEX_TABLE, INDEX_TABLE, VECTOR, REAL,
        INDICES, INDICES, INDICES, REAL, INDICES, INDICES,
    ),
    allocates=True,
)  # fmt: skip
def _fill_list(  # type: ignore[no-untyped-def]
    x, nodes, weights, homes, triangles, films, relation, low, size, counts, start, entries, room, first,
    listed,
):  # fmt: skip
    """Fill each point's triangles, in ascending order; return how many there are (as `_fill_grid` does)."""
    total = 0
    y = np.empty(3)
    for p in range(nodes.shape[0]):
        first[p], cell = total, 0
        for r in range(3):
            y[r] = 0.0
            for a in range(3):
                y[r] += weights[p, a] * x[nodes[p, a], r]
            cell = cell * counts[r] + _cell(y[r], low[r], size, counts[r])
        for entry in range(start[cell], start[cell + 1]):
            t = entries[entry]
            kind = relation[homes[p, 0], films[t, 0]]
            # across a valley a point counts nothing that it hangs on
            if kind == 0 or (kind == _VALLEY and _share_nodes(nodes[p], triangles[t])):
                continue
            a, b, c = x[triangles[t, 0]], x[triangles[t, 1]], x[triangles[t, 2]]
            if _square_to_box(y, a, b, c) > room * room:
                continue
            if total < listed.shape[0]:
                listed[total] = t
            total += 1
    first[nodes.shape[0]] = total
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
        self.faces, self._nodes, self._weights, self._home = faces, nodes, weights, home
        self.films: IntArray = np.column_stack([faces.face, faces.unit])
        self.first: IntArray = np.zeros(len(nodes) + 1, np.int64)
        self.listed: IntArray = np.empty(8 * len(nodes), np.int64)
        self._entries: IntArray = np.empty(64 * len(faces.triangles), np.int64)
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
        faces, size = self.faces, np.empty(8)
        _measure(positions, faces.triangles, size)
        # half a triangle to a cell
        low, extent = size[:3].copy(), size[3:6] - size[:3]
        cell = max(0.5 * float(size[6]), float(extent.max()) / _CELLS_MAX, 1e-9)
        counts = np.minimum((extent / cell).astype(np.int64) + 1, _CELLS_MAX)
        beyond = 2.0 * BEYOND_EDGES * float(size[7])
        room, start = room_m + beyond, np.empty(counts.prod() + 1, np.int64)
        while True:
            needed = _fill_grid(positions, faces.triangles, low, cell, counts, room, start, self._entries)
            if needed <= len(self._entries):
                break
            self._entries = np.empty(2 * needed, np.int64)
        while True:
            needed = _fill_list(
                positions, self._nodes, self._weights, self._home, faces.triangles, self.films,
                faces.relation, low, cell, counts, start, self._entries, room, self.first, self.listed,
            )  # fmt: skip
            if needed <= len(self.listed):
                break
            self.listed = np.empty(2 * needed, np.int64)
        return beyond
