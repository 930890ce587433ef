"""Search for points of a film near shapes, and shape features near the film, by neighbour lists.

A list stays valid while the film has hardly moved in the frames of the shapes. If no node has moved further
there than m since the lists were built, pairs nearer than r now were nearer than r + m then: points of the
film and shapes, sharp features of shapes and triangles of the film.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Indices, Matrix
from cosim.base.kernels import kernel, unchecked
from cosim.coupling.contact.contact_arrays import NearFeatures
from cosim.coupling.contact.contact_kernels import fill_holding_triangles
from cosim.coupling.contact.contact_report import ContactMemory
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.feature_points import carry
from cosim.rigid.distance.film_distance import FeatureRows, FilmReach, FilmTriangles, TriangleLists, film_near
from cosim.rigid.distance.shapes import ShapePoses
from cosim.rigid.distance.signed_distance import HitRows, PointLists, points_near
from cosim.soft.contact.contact_points import ContactSurface, Extent


class NearFilm(NamedTuple):
    """Points of the film near shapes, and features of shapes near the film; valid until the next search."""

    points: HitRows
    features: NearFeatures


@kernel
def furthest_in_shapes(x: Matrix, poses: ShapePoses, active: Indices, row: Indices, local: Blocks) -> float:
    """Return the largest distance [m] that a node has moved in the frames of active shapes.

    Args:
        x: (n, 3) [m], of the nodes, world.
        poses: of the shapes.
        active: (a,) shapes.
        row: (g,), row of each shape in `local`; -1 for an unlisted one, for which the result is infinite.
        local: (s, n, 3) [m], the nodes when the lists were built, in the frames of s shapes.
    """
    largest_square = 0.0
    for g in active:
        if row[g] < 0:
            return np.inf
        turn, origin, before = poses.rotation[g], poses.position[g], local[row[g]]
        for n in range(x.shape[0]):
            dx, dy, dz = x[n, 0] - origin[0], x[n, 1] - origin[1], x[n, 2] - origin[2]
            square = 0.0
            for r in range(3):
                square += (turn[0, r] * dx + turn[1, r] * dy + turn[2, r] * dz - before[n, r]) ** 2
            largest_square = max(largest_square, square)
    return np.sqrt(largest_square)


@final
class NearSearch:
    """Finds points of a film near shapes, and features of shapes near the film.

    Args:
        query: distances to the shapes; its poses are read.
        surface: of the film.
    """

    def __init__(self, query: ContactQuery, surface: ContactSurface) -> None:
        self._query, self._surface = query, surface
        self.points = np.zeros((len(surface), 3))
        """(p, 3) [m], positions of the film's points; not updated for points far from all shapes."""
        self._first_key = len(query) * len(surface)
        """Key of the first feature."""
        self._reach_m, self._behind_m = -np.inf, -np.inf  # for which the lists are complete
        self._row, self._local = np.full(len(query), -1), np.zeros((0, 0, 3))
        no_indices = np.zeros(0, np.int64)
        self._set_lists(
            PointLists(no_indices, np.zeros((0, 2), np.int64), no_indices),
            no_indices,
            TriangleLists(no_indices, no_indices),
        )

    def find(
        self, x: Array, extent: Extent, active: IntArray, bounds: tuple[float, float], memory: ContactMemory
    ) -> NearFilm | None:
        """Return the points and features that are near; None if the lists are not valid any more.

        Args:
            x: (n, 3) [m], of the nodes.
            extent: of the film.
            active: (a,) shapes that may be near it.
            bounds: largest distance, and how far behind the film a feature still counts [m].
            memory: of the contacts that pressed: which triangles have held features back.
        """
        reach_m, behind_m = bounds
        moved_m = furthest_in_shapes(x, self._query.poses, active, self._row, self._local)
        if not (reach_m + moved_m <= self._reach_m and behind_m + moved_m <= self._behind_m):
            return None
        return NearFilm(
            self._find_points(x, active, reach_m), self._find_features(x, extent, reach_m, behind_m, memory)
        )

    def _find_points(self, x: Array, active: IntArray, reach_m: float) -> HitRows:
        lists, points, hits = self._points, self.points, self._hits
        spans = lists.spans[self._row[active]]
        for first, last in spans.tolist():
            self._surface.fill_points(x, lists.listed[first:last], points)
        query = self._query
        active_lists = PointLists(active, spans, lists.listed)
        count = unchecked(points_near)(points, query.shapes, query.poses, active_lists, reach_m, hits)
        return HitRows(hits.point[:count], hits.shape[:count], hits.found[:count])

    def _find_features(
        self, x: Array, extent: Extent, reach_m: float, behind_m: float, memory: ContactMemory
    ) -> NearFeatures:
        query, listed, positions, rows, count = self._query, self._listed, self._positions, self._rows, 0
        if len(listed):
            fill_holding_triangles(memory, listed, self._first_key, self._holding)
            features = query.features
            carry(query.position, query.rotation, features.shape, features.position, listed, positions)
            film = FilmTriangles(x, self._surface.triangles)
            reach = FilmReach(reach_m, behind_m, extent.low - reach_m, extent.high + reach_m)
            count = unchecked(film_near)(positions, film, self._triangles, reach, self._holding, rows)
        point, gap = rows.point[:count], rows.found[:count]
        feature = listed[point]
        owner, position = query.features.shape[feature], positions[point]
        return NearFeatures(feature, owner, position, rows.triangle[:count], rows.weight[:count], gap)

    def build_lists(self, x: Array, extent: Extent, reach_m: float, behind_m: float) -> None:
        """Build lists of pairs up to these distances.

        Args:
            x: (n, 3) [m], of the nodes.
            extent: of the film.
            reach_m: largest distance of points and features.
            behind_m: how far behind the film a feature still counts.
        """
        query, margin = self._query, max(reach_m, behind_m)
        shapes = query.near(extent.low, extent.high, reach_m)
        frames = [(x - query.position[g]) @ query.rotation[g] for g in shapes]
        points = query.points_around(self._surface.points(x), reach_m, shapes)
        self._row = np.full(len(query), -1)
        self._row[shapes] = np.arange(len(shapes))
        features = query.features.of(shapes)
        positions = query.feature_positions(features)
        near = ((positions > extent.low - margin) & (positions < extent.high + margin)).all(axis=1)
        features, positions = features[near], positions[near]
        self._local = np.array(frames).reshape(-1, *x.shape)
        self._reach_m, self._behind_m = reach_m, behind_m
        triangles = TriangleLists.around(positions, x, self._surface.triangles, margin)
        self._set_lists(points, features, triangles)

    def _set_lists(self, points: PointLists, features: IntArray, triangles: TriangleLists) -> None:
        """Set the lists, and allocate arrays for their results."""
        listed, count = len(points.listed), len(features)
        self._points, self._listed, self._triangles = points, features, triangles
        self._hits = HitRows(np.empty(listed, np.int64), np.empty(listed, np.int64), np.empty((listed, 4)))
        point, triangle, self._holding = (np.empty(count, np.int64) for _ in range(3))
        self._rows = FeatureRows(point, triangle, np.empty((count, 3)), np.empty((count, 4)))
        self._positions = np.empty((count, 3))
