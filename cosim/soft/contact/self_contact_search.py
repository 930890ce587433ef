"""Which points of a film lie over which triangles of its other units: uniform grid, then foot on the plane.

A point is over a triangle if its foot on the plane lies in the triangle (`_MARGIN` beyond its edges, so that
none slips through between two) and its distance is in -behind .. reach. Of the triangles of one unit it gets
the nearest, and only if the two films face each other there; see `film_faces.Relation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDEX_TABLE, INDICES, INTEGER, MATRIX, REAL, VECTOR, device_function, kernel
from cosim.soft.contact.self_contact_faces import FilmFaces, Relation
from cosim.soft.contact.self_contact_pairs import foot_on_plane
from cosim.soft.contact.self_contact_points import FilmPoints

_MARGIN = 0.02
_CELLS_MAX = 48  # along each axis
_UNITS_NEAR = 8  # other units over which one point can be at a time
_TIE_M = 1e-12  # two triangles at equal distance: the one in front of which the point lies more
_FACING = {Relation.VALLEY: 0.0, Relation.APART: 0.5}  # largest cosine of the two outer normals
_VALLEY, _FACING_VALLEY, _FACING_APART = (
    int(Relation.VALLEY),
    _FACING[Relation.VALLEY],
    _FACING[Relation.APART],
)


@device_function
def _cell(value, low, size, count):  # type: ignore[no-untyped-def]
    return min(max(int((value - low) / size), 0), count - 1)


@kernel(INTEGER(MATRIX, INDEX_TABLE, VECTOR, REAL, INDICES, REAL, INDICES, INDICES))
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
def _cosine(outward, n):  # type: ignore[no-untyped-def]
    """Return the cosine of the angle between two directions, the second of unit length."""
    size = np.sqrt(outward[0] * outward[0] + outward[1] * outward[1] + outward[2] * outward[2])
    return (outward[0] * n[0] + outward[1] * n[1] + outward[2] * n[2]) / size


@device_function
def _share_nodes(nodes, corners):  # type: ignore[no-untyped-def]
    """Return whether a point and a triangle have a node in common."""
    for a in range(3):
        for b in range(3):
            if nodes[a] == corners[b]:
                return True
    return False


@kernel(
    INTEGER(
        MATRIX, MATRIX, MATRIX, INDEX_TABLE, INDEX_TABLE, INDEX_TABLE, MATRIX, INDEX_TABLE, INDEX_TABLE,
        VECTOR, REAL, INDICES, INDICES, INDICES, REAL, REAL, INDEX_TABLE,
    )
)  # fmt: skip
def _over(  # type: ignore[no-untyped-def]
    x, place, outward, nodes, homes, triangles, normals, films, relation, low, size, counts, start, entries,
    reach, behind, out,
):  # fmt: skip
    """Fill rows (point, triangle) of what lies over what; return how many that takes."""
    n, weight, slope = np.empty(3), np.empty(3), np.empty((3, 3))
    units, best = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR)
    chosen, distance = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR)
    count = 0
    for p in range(place.shape[0]):
        near, y, cell = 0, place[p], 0
        for r in range(3):
            cell = cell * counts[r] + _cell(y[r], low[r], size, counts[r])
        for entry in range(start[cell], start[cell + 1]):
            t = entries[entry]
            kind = relation[homes[p, 0], films[t, 0]]
            if kind == 0:
                continue
            a, d = triangles[t, 0], 0.0
            for r in range(3):
                d += normals[t, r] * (y[r] - x[a, r])
            if d < -behind or d > (reach if kind == _VALLEY else max(reach, behind)):
                continue
            facing = _cosine(outward[p], normals[t]) < (_FACING_VALLEY if kind == _VALLEY else _FACING_APART)
            if kind == _VALLEY and (not facing or _share_nodes(nodes[p], triangles[t])):
                continue
            d = foot_on_plane(x, triangles[t], y, n, weight, slope)
            if not min(weight[0], weight[1], weight[2]) >= -_MARGIN:
                continue
            slot = 0
            while slot < near and units[slot] != films[t, 1]:
                slot += 1
            if slot == _UNITS_NEAR:
                continue
            if slot == near:
                near, units[slot], best[slot], distance[slot] = near + 1, films[t, 1], np.inf, -np.inf
            closer = abs(d) < best[slot] - _TIE_M
            if closer or (abs(d) < best[slot] + _TIE_M and d > distance[slot]):
                best[slot], distance[slot], chosen[slot] = abs(d), d, t if facing else -1
        for slot in range(near):
            if chosen[slot] >= 0 and distance[slot] < reach:
                if count < out.shape[0]:
                    out[count, 0], out[count, 1] = p, chosen[slot]
                count += 1
    return count


@final
@dataclass(frozen=True)
class FilmHits:
    """Contact points over triangles of other units.

    Args:
        point: (k,) index of the point.
        triangle: (k,).
    """

    point: IntArray
    triangle: IntArray


@final
class FilmSearch:
    """Finds which points of a film lie over which triangles.

    Args:
        faces: of the film.
        points: of the film.
    """

    def __init__(self, faces: FilmFaces, points: FilmPoints) -> None:
        self.faces, self.points = faces, points
        self._films = np.column_stack([faces.face, faces.unit])
        self._entries = np.empty(64 * len(faces.triangles), np.int64)
        self._out = np.empty((2 * len(points), 2), np.int64)

    def near(self, positions: Array, reach_m: float, behind_m: float) -> FilmHits:
        """Return the pairs at distances in -behind_m .. reach_m.

        Args:
            positions: (n, 3) [m], of the nodes.
            reach_m: in front of the triangle.
            behind_m: behind it.
        """
        faces, points = self.faces, self.points
        place, outward, normals = points.outline(positions)
        low, size, counts = self._grid(positions)
        start = np.empty(int(counts.prod()) + 1, np.int64)
        room = max(reach_m, behind_m)
        while True:
            needed = _fill_grid(positions, faces.triangles, low, size, counts, room, start, self._entries)
            if needed <= len(self._entries):
                break
            self._entries = np.empty(2 * needed, np.int64)
        while True:
            count = _over(
                positions, place, outward, points.nodes, points.home, faces.triangles, normals,
                self._films, faces.relation, low, size, counts, start, self._entries, reach_m, behind_m,
                self._out,
            )  # fmt: skip
            if count <= len(self._out):
                break
            self._out = np.empty((2 * count, 2), np.int64)
        return FilmHits(self._out[:count, 0].copy(), self._out[:count, 1].copy())

    def _grid(self, positions: Array) -> tuple[Array, float, IntArray]:
        """Return lowest corner, cell size [m] and cells along each axis: half a triangle to a cell."""
        low, high = positions.min(axis=0), positions.max(axis=0)
        corners = positions[self.faces.triangles]
        typical = float((corners.max(axis=1) - corners.min(axis=1)).max(axis=1).mean())
        size = max(0.5 * typical, float((high - low).max()) / _CELLS_MAX, 1e-9)
        return low, size, np.minimum(((high - low) / size).astype(np.int64) + 1, _CELLS_MAX)
