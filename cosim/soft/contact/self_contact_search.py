"""Which points of a film lie over which triangles of its other units: candidates, then foot on the plane.

A point is over a triangle if its foot on the plane lies in the triangle (`BEYOND_EDGES`, so that none slips
through between two) and its distance is in -behind .. reach. Of the triangles of one unit it gets the
nearest, and only if the two films face each other there; see `film_faces.Relation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import (
    INDEX_TABLE,
    INDICES,
    INTEGER,
    MATRIX,
    REAL,
    device_function,
    kernel,
)
from cosim.soft.contact.self_contact_candidates import FilmCandidates
from cosim.soft.contact.self_contact_faces import FilmFaces, Relation
from cosim.soft.contact.self_contact_motion import BEYOND_EDGES
from cosim.soft.contact.self_contact_points import FilmPoints
from cosim.soft.contact.self_contact_short_list import ShortList, measure_sides, over_side

_UNITS_NEAR = 8  # other units over which one point can be at a time
_TIE_M = 1e-12  # two triangles at equal distance: the one in front of which the point lies more
_FACING = {Relation.VALLEY: 0.0, Relation.APART: 0.5}  # largest cosine of the two outer normals
_VALLEY, _FACING_VALLEY, _FACING_APART = (
    int(Relation.VALLEY),
    _FACING[Relation.VALLEY],
    _FACING[Relation.APART],
)


@device_function
def _cosine(outward, n):  # type: ignore[no-untyped-def]
    """Return the cosine of the angle between two directions, the second of unit length."""
    size = np.sqrt(outward[0] * outward[0] + outward[1] * outward[1] + outward[2] * outward[2])
    return (outward[0] * n[0] + outward[1] * n[1] + outward[2] * n[2]) / size


@kernel(
    INTEGER(
        MATRIX, MATRIX, MATRIX, INDEX_TABLE, INDEX_TABLE, INDEX_TABLE, INDICES, INDICES, REAL, REAL,
        INDEX_TABLE,
    ),
    allocates=True,
)  # fmt: skip
def _over(  # type: ignore[no-untyped-def]
    sides, place, outward, homes, films, relation, first, listed, reach, behind, out
):
    """Fill rows (point, triangle) of what lies over what, ascending by point, then by the triangle's unit.

    Returns:
        How many that takes; none are written beyond the room.
    """
    units, best = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR)
    chosen, distance = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR)
    count, furthest = 0, max(reach, behind)
    for p in range(place.shape[0]):
        near, px, py, pz = 0, place[p, 0], place[p, 1], place[p, 2]
        for entry in range(first[p], first[p + 1]):
            t = listed[entry]
            d, weight = over_side(sides[t], px, py, pz)
            if d < -behind or d > furthest or not weight >= -BEYOND_EDGES:
                continue
            kind = relation[homes[p, 0], films[t, 0]]
            facing = _cosine(outward[p], sides[t, 3:6]) < (
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

    def near(self, positions: Array, reach_m: float, behind_m: float) -> FilmHits:
        """Return the pairs at distances in -behind_m .. reach_m.

        Args:
            positions: (n, 3) [m], of the nodes.
            reach_m: in front of the triangle.
            behind_m: behind it.
        """
        faces, points, short, sides = self.faces, self.points, self._short, self._sides
        place, outward, _ = points.outline(positions)
        measure_sides(positions, faces.triangles, sides)
        room = max(reach_m, behind_m)
        if self._candidates.update(positions, room) or not short.serves(positions, room, behind_m):
            candidates, near = (self._candidates.first, self._candidates.listed), self._candidates.near
            short.make(positions, place, sides, candidates, near, room, behind_m)
        while True:
            count = _over(
                sides, place, outward, points.home, self._candidates.films, faces.relation,
                short.first, short.listed, reach_m, behind_m, self._out,
            )  # fmt: skip
            if count <= len(self._out):
                break
            self._out = np.empty((2 * count, 2), np.int64)
        return FilmHits(self._out[:count, 0].copy(), self._out[:count, 1].copy())
