"""Which points of a film lie over which triangles of its other units: candidates, then foot on the plane.

A point is over a triangle if its foot on the plane lies in the triangle (`BEYOND_EDGES`, so that none slips
through between two) and its distance is in -behind .. reach. Of the triangles of one unit it gets the
nearest, and only if the two films face each other there; see `film_faces.Relation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import (
    IndexTable,
    Indices,
    Matrix,
    Vector,
    device_function,
    kernel,
)
from cosim.soft.contact.self_contact_candidates import (
    BEYOND_EDGES,
    FilmCandidates,
    ShortList,
    measure_sides,
    over_plane,
    over_side,
)
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints, Relation

_UNITS_NEAR = 8  # other units over which one point can be at a time
_TIE_M = 1e-12  # two triangles at equal distance: the one in front of which the point lies more
_FACING = {Relation.VALLEY: 0.0, Relation.APART: 0.5}  # largest cosine of the two outer normals
_VALLEY, _FACING_VALLEY, _FACING_APART = (
    int(Relation.VALLEY),
    _FACING[Relation.VALLEY],
    _FACING[Relation.APART],
)


class SearchRows(NamedTuple):
    """Points and triangles that are searched.

    Args:
        homes: (p, 2) face and unit of each point.
        films: (t, 2) face and unit of each triangle.
        relation: (f, f) of faces.
        triangles: (t, 3).
        start: (p + 1,), where the triangles around each point begin.
        around: these.
    """

    homes: IndexTable
    films: IndexTable
    relation: IndexTable
    triangles: IndexTable
    start: Indices
    around: Indices


class NearList(NamedTuple):
    """What may lie over what.

    Args:
        first: (p + 1,), where the triangles of each point begin.
        listed: these.
        reach: [m], in front of a triangle.
        behind: [m], behind it.
    """

    first: Indices
    listed: Indices
    reach: float
    behind: float


@device_function
def _faces(x: Matrix, rows: SearchRows, p: int, n: Vector) -> float:
    """Return the cosine of the angle between a point's outer normal and a direction of unit length."""
    ox = oy = oz = 0.0
    for k in range(rows.start[p], rows.start[p + 1]):
        t = rows.around[k]
        a, b, c = rows.triangles[t, 0], rows.triangles[t, 1], rows.triangles[t, 2]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        ox, oy, oz = ox + (uy * vz - uz * vy), oy + (uz * vx - ux * vz), oz + (ux * vy - uy * vx)
    return (ox * n[0] + oy * n[1] + oz * n[2]) / np.sqrt(ox * ox + oy * oy + oz * oz)


@kernel
def _fill_places(x: Matrix, nodes: IndexTable, weights: Matrix, place: Matrix) -> None:
    for p in range(nodes.shape[0]):
        for r in range(3):
            place[p, r] = 0.0
            for a in range(3):
                place[p, r] += weights[p, a] * x[nodes[p, a], r]


@kernel(allocates=True)
def _over(
    x: Matrix, sides: Matrix, place: Matrix, rows: SearchRows, near_list: NearList, out: IndexTable
) -> int:
    """Fill rows (point, triangle) of what lies over what, ascending by point, then by the triangle's unit.

    Returns:
        How many that takes; none are written beyond the room.
    """
    units, best = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR)
    chosen, distance = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR)
    reach, behind = near_list.reach, near_list.behind
    films, count, furthest = rows.films, 0, max(reach, behind)
    for p in range(place.shape[0]):
        near, px, py, pz = 0, place[p, 0], place[p, 1], place[p, 2]
        for entry in range(near_list.first[p], near_list.first[p + 1]):
            t = near_list.listed[entry]
            d = over_plane(sides[t], px, py, pz)
            if d < -behind or d > furthest:
                continue
            _, weight = over_side(sides[t], px, py, pz)
            if not weight >= -BEYOND_EDGES:
                continue
            kind = rows.relation[rows.homes[p, 0], films[t, 0]]
            facing = _faces(x, rows, p, sides[t, 3:6]) < (
                _FACING_VALLEY if kind == _VALLEY else _FACING_APART
            )
            if kind == _VALLEY and (d > reach or not facing):
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
        begin = count
        for slot in range(near):
            if chosen[slot] < 0 or not distance[slot] < reach:
                continue
            if count < out.shape[0]:
                at = count
                while at > begin and films[out[at - 1, 1], 1] > units[slot]:
                    out[at, 1] = out[at - 1, 1]
                    at -= 1
                out[count, 0], out[at, 1] = p, chosen[slot]
            count += 1
    return count


@final
@dataclass(frozen=True)
class FilmHits:
    """Contact points over triangles of other units, ascending by point, then by unit.

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
        self._candidates = FilmCandidates(faces, points.nodes, points.weights, points.home)
        self._short = ShortList(self._candidates.motion, len(points))
        self._sides = np.empty((len(faces.triangles), 12))
        self._out = np.empty((2 * len(points), 2), np.int64)
        self._place = np.empty((len(points), 3))
        self._rows = SearchRows(
            points.home, self._candidates.films, faces.relation, faces.triangles, *points.around
        )  # fmt: skip

    def near(self, positions: Array, reach_m: float, behind_m: float) -> FilmHits:
        """Return the pairs at distances in -behind_m .. reach_m.

        Args:
            positions: (n, 3) [m], of the nodes.
            reach_m: in front of the triangle.
            behind_m: behind it.
        """
        points, short, sides, place = self.points, self._short, self._sides, self._place
        _fill_places(positions, points.nodes, points.weights, place)
        measure_sides(positions, self.faces.triangles, sides)
        room = max(reach_m, behind_m)
        if self._candidates.update(positions, room) or not short.serves(positions, room, behind_m):
            candidates, near = (self._candidates.first, self._candidates.listed), self._candidates.near
            short.make(positions, place, sides, candidates, near, room, behind_m)
        near_list = NearList(short.first, short.listed, reach_m, behind_m)
        while True:
            count = _over(positions, sides, place, self._rows, near_list, self._out)
            if count <= len(self._out):
                break
            self._out = np.empty((2 * count, 2), np.int64)
        return FilmHits(self._out[:count, 0].copy(), self._out[:count, 1].copy())
