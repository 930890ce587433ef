"""Film and shapes near each other, found through lists that are made anew where they serve no longer."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import final

import numpy as np

from cosim.base.compilation import compile_modules
from cosim.base.frames import Array, IntArray
from cosim.base.kernels import nothing_of
from cosim.coupling.contact import contact_kernels, film_search
from cosim.coupling.contact.contact_arrays import NearPoints, SurfaceRows
from cosim.coupling.contact.film_search import (
    LISTS,
    ListRows,
    Search,
    ShapeSurfaces,
    find_near,
    search_calls,
)
from cosim.rigid.distance import features, film_distance, mesh_distance, signed_distance
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.film_distance import TriangleLists
from cosim.soft.contact.contact_points import ContactSurface, Extent

_MARGIN_M = 8e-3  # more of it lengthens the lists, less makes them anew more often


def contact_modules() -> tuple[ModuleType, ...]:
    """Return the modules with kernels of contact with a scene."""
    return contact_kernels, features, film_distance, film_search, mesh_distance, signed_distance


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
    """Finds what of a film and of shapes is near each other; `search` is what kernels take for it.

    The kernels of contact are compiled when something is near for the first time: many runs need none.
    `begun` is whether that has been.

    Args:
        query: to the shapes.
        surface: of the film.
    """

    def __init__(self, query: ContactQuery, surface: ContactSurface) -> None:
        self._query, self._surface = query, surface
        self._places, self.begun = np.zeros((len(surface), 3)), False

    @cached_property
    def _calls(self) -> IntArray:
        compile_modules(logging.getLogger("cosim").warning, contact_modules())
        self.begun = True
        return search_calls()

    @cached_property
    def search(self) -> Search:
        """What kernels take; its lists serve for nothing yet."""
        return self._searching(nothing_of(LISTS))

    def find(
        self,
        positions: Array,
        extent: Extent,
        active: IntArray,
        reach_m: float,
        behind_m: float,
        held: IntArray | None = None,
    ) -> Neighbours:
        """Return what is near at the query's present poses; it holds until the next search.

        Args:
            positions: (n, 3) [m], of the nodes.
            extent: of the film.
            active: (a,) shapes that may be near it.
            reach_m: bound on the distance.
            behind_m: how far behind the film a feature still counts.
            held: (features,) the triangle that has held each back until now, -1 for none; none unless given.
        """
        bounds = extent.low, extent.high, active, reach_m, behind_m
        held = np.full(len(self._query.features.shape), -1) if held is None else held
        self.search.held[:] = held[self.search.lists.features]
        points, features = find_near(positions, *bounds, self.search)
        if points < 0:  # the lists serve no longer
            self.search = self._made(positions, extent, reach_m + _MARGIN_M, behind_m + _MARGIN_M)
            self.search.held[:] = held[self.search.lists.features]
            points, features = find_near(positions, *bounds, self.search)
        return Neighbours(self.search.near.first(points, features), self._places)

    def _made(self, positions: Array, extent: Extent, reach_m: float, behind_m: float) -> Search:
        """Return a search by lists that hold to such distances at present."""
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
        lists = ListRows(
            row, np.array(local), reach_m, behind_m, points.spans, points.listed, features, found.first,
            found.listed,
        )  # fmt: skip
        return self._searching(lists)

    def _searching(self, lists: ListRows) -> Search:
        query, surface = self._query, self._surface
        shapes = ShapeSurfaces(*(getattr(query.shapes, name) for name in ShapeSurfaces._fields))
        rows = SurfaceRows(*(getattr(surface, name) for name in SurfaceRows._fields))
        features = query.features.shape, query.features.position
        near = NearPoints.room(len(lists.listed), len(lists.features))
        scratch = np.empty((max(len(lists.listed), len(lists.features)), 4)), np.empty((2, 3))
        return Search(
            query.bounds, shapes, *features, rows, lists, near, np.empty_like(lists.features), self._places,
            np.empty_like(lists.spans), np.empty((len(lists.features), 3)), np.empty_like(lists.features),
            *scratch, self._calls,
        )  # fmt: skip
