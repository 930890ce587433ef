"""Film and shapes near each other, found through lists that serve until the film has moved too far.

A shape does not move in its own frame. So while no node of the film has gone further there than m since the
lists were made, what is nearer than r now was nearer than r + m then: points of the film to the shape, the
shape's sharp features to triangles of the film.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDICES, MATRIX, REAL, kernel
from cosim.coupling.contact.contact_arrays import NearPoints
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.film_distance import TriangleLists, near_film
from cosim.rigid.distance.signed_distance import PointLists
from cosim.soft.contact.contact_points import ContactSurface, Extent

_MARGIN_M = 4e-3  # more of it lengthens the lists, less makes them anew more often


@kernel(REAL(MATRIX, MATRIX, BLOCKS, INDICES, INDICES, BLOCKS))
def _gone(x, position, rotation, active, row, local):  # type: ignore[no-untyped-def]
    """Return how far a node has gone at most in the frame of an active shape; infinite for one not listed."""
    most = 0.0
    for g in active:
        if row[g] < 0:
            return np.inf
        turn, place, before = rotation[g], position[g], local[row[g]]
        for n in range(x.shape[0]):
            dx, dy, dz = x[n, 0] - place[0], x[n, 1] - place[1], x[n, 2] - place[2]
            square = 0.0
            for r in range(3):
                square += (turn[0, r] * dx + turn[1, r] * dy + turn[2, r] * dz - before[n, r]) ** 2
            most = max(most, square)
    return np.sqrt(most)


@final
@dataclass(frozen=True)
class Lists:
    """What was near when they were made.

    Args:
        row: (g,) of each shape in the arrays that follow; -1 for one that was too far.
        local: (s, n, 3) [m], the nodes then, in the frames of s shapes.
        reach_m: distance to which the lists hold.
        behind_m: the same for features behind the film.
        points: of the film, for each of the s shapes.
        features: (k,) that were near a triangle.
        triangles: of the film, for each of these.
    """

    row: IntArray
    local: Array
    reach_m: float
    behind_m: float
    points: PointLists
    features: IntArray
    triangles: TriangleLists


@final
@dataclass(frozen=True)
class Neighbours:
    """What is near now.

    Args:
        rows: the pairs.
        places: (p, 3) [m], of the film's points; those that no shape is near may be anywhere.
    """

    rows: NearPoints
    places: Array

    @property
    def count(self) -> int:
        """How many pairs."""
        return len(self.rows.point) + len(self.rows.triangle)


@final
class FilmNeighbours:
    """Finds what of a film and of shapes is near each other.

    Args:
        query: to the shapes.
        surface: of the film.
    """

    def __init__(self, query: ContactQuery, surface: ContactSurface) -> None:
        self._query, self._surface = query, surface
        self._lists: Lists | None = None
        self._places = np.zeros((len(surface), 3))

    def find(
        self, positions: Array, extent: Extent, active: IntArray, reach_m: float, behind_m: float
    ) -> Neighbours:
        """Return what is near at the query's present poses.

        Args:
            positions: (n, 3) [m], of the nodes.
            extent: of the film.
            active: (a,) shapes that may be near it.
            reach_m: bound on the distance.
            behind_m: how far behind the film a feature still counts.
        """
        query, triangles = self._query, self._surface.triangles
        lists = self._serving(positions, extent, active, reach_m, behind_m)
        spans = lists.points.spans[lists.row[active]]
        for first, last in spans.tolist():
            self._surface.fill_points(positions, lists.points.listed[first:last], self._places)
        hits = query.distances(self._places, reach_m, active, PointLists(spans, lists.points.listed))
        around = query.feature_positions(lists.features)
        within = extent.low - reach_m, extent.high + reach_m
        film = near_film(around, positions, triangles, reach_m, behind_m, lists.triangles, within)
        feature = lists.features[film.point]
        rows = NearPoints(
            hits.point, hits.shape, hits.distance, hits.normal, feature, query.features.shape[feature],
            around[film.point], film.triangle, film.weight, film.distance, film.normal,
        )  # fmt: skip
        return Neighbours(rows, self._places)

    def _serving(
        self, positions: Array, extent: Extent, active: IntArray, reach_m: float, behind_m: float
    ) -> Lists:
        """Return lists that serve: the last ones, or new ones."""
        lists, query = self._lists, self._query
        if lists is not None:
            gone = _gone(positions, query.position, query.rotation, active, lists.row, lists.local)
            if reach_m + gone <= lists.reach_m and behind_m + gone <= lists.behind_m:
                return lists
        lists = self._lists = self._made(positions, extent, reach_m + _MARGIN_M, behind_m + _MARGIN_M)
        return lists

    def _made(self, positions: Array, extent: Extent, reach_m: float, behind_m: float) -> Lists:
        """Return lists that hold to such distances at present."""
        query, room = self._query, max(reach_m, behind_m)
        shapes = query.near(extent.low, extent.high, reach_m)
        local = [(positions - query.position[g]) @ query.rotation[g] for g in shapes]
        points = query.points_around(self._surface.points(positions), reach_m, shapes)
        row = np.full(len(query), -1)
        row[shapes] = np.arange(len(shapes))
        features = query.features.of(shapes)
        places = query.feature_positions(features)
        near = ((places > extent.low - room) & (places < extent.high + room)).all(axis=1)
        features, places = features[near], places[near]
        found = TriangleLists.around(places, positions, self._surface.triangles, room)
        return Lists(row, np.array(local), reach_m, behind_m, points, features, found)
