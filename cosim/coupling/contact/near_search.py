"""What of a film is near shapes, found through lists.

The lists are valid until the film has moved. A shape does not move in its own frame. So while no node of the
film has gone further there than m since the lists were made, what is nearer than r now was nearer than r + m
then: points of the film to the shape, the shape's sharp features to triangles of the film.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Indices, Matrix
from cosim.base.kernels import kernel, unchecked
from cosim.coupling.contact.contact_arrays import NearFeatures
from cosim.coupling.contact.contact_kernels import fill_held
from cosim.coupling.contact.contact_report import ContactMemory
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.feature_points import carry
from cosim.rigid.distance.film_distance import FeatureRows, FilmReach, FilmTriangles, TriangleLists, film_near
from cosim.rigid.distance.shapes import ShapePoses
from cosim.rigid.distance.signed_distance import HitRows, PointLists, points_near
from cosim.soft.contact.contact_points import ContactSurface, Extent


class NearFilm(NamedTuple):
    """Points of the film near shapes, features of shapes near the film; overwritten by the next search."""

    points: HitRows
    features: NearFeatures


@kernel
def furthest_in_shapes(x: Matrix, poses: ShapePoses, active: Indices, row: Indices, local: Blocks) -> float:
    """Return how far [m] a node has gone at most in the frames of active shapes; infinite if one is unlisted.

    Args:
        x: (n, 3) [m], of the nodes, world.
        poses: of the shapes.
        active: (a,) shapes.
        row: (g,) of each shape in `local`; -1 for one that is not listed.
        local: (s, n, 3) [m], the nodes before, in the frames of s shapes.
    """
    most = 0.0
    for g in active:
        if row[g] < 0:
            return np.inf
        turn, place, before = poses.rotation[g], poses.position[g], local[row[g]]
        for n in range(x.shape[0]):
            dx, dy, dz = x[n, 0] - place[0], x[n, 1] - place[1], x[n, 2] - place[2]
            square = 0.0
            for r in range(3):
                square += (turn[0, r] * dx + turn[1, r] * dy + turn[2, r] * dz - before[n, r]) ** 2
            most = max(most, square)
    return np.sqrt(most)


@final
class NearSearch:
    """Finds what of a film is near shapes.

    Args:
        query: distances to the shapes; its poses are read.
        surface: of the film.
    """

    def __init__(self, query: ContactQuery, surface: ContactSurface) -> None:
        self._query, self._surface = query, surface
        self.places = np.zeros((len(surface), 3))
        """(p, 3) [m], of the film's points; those that no shape is near may be anywhere."""
        self._first_key = len(query) * len(surface)
        """Key of the first feature."""
        self._reach_m, self._behind_m = -np.inf, -np.inf  # to which the lists hold
        self._row, self._local = np.full(len(query), -1), np.zeros((0, 0, 3))
        none = np.zeros(0, np.int64)
        self._take_lists(PointLists(none, np.zeros((0, 2), np.int64), none), none, TriangleLists(none, none))

    def find(
        self, x: Array, extent: Extent, active: IntArray, bounds: tuple[float, float], memory: ContactMemory
    ) -> NearFilm | None:
        """Return what is near; None where the lists are not valid.

        Args:
            x: (n, 3) [m], of the nodes.
            extent: of the film.
            active: (a,) shapes that may be near it.
            bounds: largest distance, and how far behind the film a feature still counts [m].
            memory: of the contacts that pressed: which triangles have held features back.
        """
        reach_m, behind_m = bounds
        gone_m = furthest_in_shapes(x, self._query.poses, active, self._row, self._local)
        if not (reach_m + gone_m <= self._reach_m and behind_m + gone_m <= self._behind_m):
            return None
        return NearFilm(
            self._find_points(x, active, reach_m), self._find_features(x, extent, reach_m, behind_m, memory)
        )

    def _find_points(self, x: Array, active: IntArray, reach_m: float) -> HitRows:
        listed, places, hits = self._points, self.places, self._hits
        spans = listed.spans[self._row[active]]
        for first, last in spans.tolist():
            self._surface.fill_points(x, listed.listed[first:last], places)
        query = self._query
        asked = PointLists(active, spans, listed.listed)
        count = unchecked(points_near)(places, query.shapes, query.poses, asked, reach_m, hits)
        return HitRows(hits.point[:count], hits.shape[:count], hits.found[:count])

    def _find_features(
        self, x: Array, extent: Extent, reach_m: float, behind_m: float, memory: ContactMemory
    ) -> NearFeatures:
        query, listed, around, rows, count = self._query, self._listed, self._around, self._rows, 0
        if len(listed):
            fill_held(memory, listed, self._first_key, self._held)
            features = query.features
            carry(query.position, query.rotation, features.shape, features.position, listed, around)
            film = FilmTriangles(x, self._surface.triangles)
            reach = FilmReach(reach_m, behind_m, extent.low - reach_m, extent.high + reach_m)
            count = unchecked(film_near)(around, film, self._triangles, reach, self._held, rows)
        point, found = rows.point[:count], rows.found[:count]
        feature = listed[point]
        owner, place = query.features.shape[feature], around[point]
        return NearFeatures(feature, owner, place, rows.triangle[:count], rows.weight[:count], found)

    def make_lists(self, x: Array, extent: Extent, reach_m: float, behind_m: float) -> None:
        """Make lists that hold to such distances at present.

        Args:
            x: (n, 3) [m], of the nodes.
            extent: of the film.
            reach_m: bound on the distance.
            behind_m: how far behind the film a feature still counts.
        """
        query, room = self._query, max(reach_m, behind_m)
        shapes = query.near(extent.low, extent.high, reach_m)
        frames = [(x - query.position[g]) @ query.rotation[g] for g in shapes]
        points = query.points_around(self._surface.points(x), reach_m, shapes)
        self._row = np.full(len(query), -1)
        self._row[shapes] = np.arange(len(shapes))
        features = query.features.of(shapes)
        places = query.feature_positions(features)
        near = ((places > extent.low - room) & (places < extent.high + room)).all(axis=1)
        features, places = features[near], places[near]
        self._local = np.array(frames).reshape(-1, *x.shape)
        self._reach_m, self._behind_m = reach_m, behind_m
        triangles = TriangleLists.around(places, x, self._surface.triangles, room)
        self._take_lists(points, features, triangles)

    def _take_lists(self, points: PointLists, features: IntArray, triangles: TriangleLists) -> None:
        """Take lists, with room for what they may find."""
        listed, count = len(points.listed), len(features)
        self._points, self._listed, self._triangles = points, features, triangles
        self._hits = HitRows(np.empty(listed, np.int64), np.empty(listed, np.int64), np.empty((listed, 4)))
        point, triangle, self._held = (np.empty(count, np.int64) for _ in range(3))
        self._rows = FeatureRows(point, triangle, np.empty((count, 3)), np.empty((count, 4)))
        self._around = np.empty((count, 3))
