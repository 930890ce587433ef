"""What is near, found through lists.

The lists are valid until the film has moved. A shape does not move in its own frame. So while no node of the
film has gone further there than m since the lists were made, what is nearer than r now was nearer than r + m
then: points of the film to the shape, the shape's sharp features to triangles of the film.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from typing import Any

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import address_of, device_function, kernel
from cosim.base.numba_insides import caller
from cosim.coupling.contact.contact_arrays import Search
from cosim.rigid.distance.film_distance import FeatureRows, FilmReach, FilmTriangles, TriangleLists, film_near
from cosim.rigid.distance.shapes import ShapePoses, carry
from cosim.rigid.distance.signed_distance import HitRows, PointLists, points_near
from cosim.soft.contact.contact_law import combine

_SEARCHED = (combine, points_near, carry, film_near)
_COMBINE, _POINTS, _CARRY, _FILM = range(len(_SEARCHED))
_combine, _points_near, _carry, _film_near = map(caller, _SEARCHED)


def search_calls() -> IntArray:
    """Return the addresses (4,) of the kernels that a search calls."""
    return np.array([address_of(called) for called in _SEARCHED])


@device_function
def _gone(
    x: Matrix, position: Matrix, rotation: Blocks, active: Indices, row: Indices, local: Blocks
) -> float:
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


@device_function
def _find_points(x: Matrix, active: Indices, reach: float, search: Any) -> int:
    """Fill the points of the film that are near active shapes; return how many."""
    bounds, lists, near, spans = search.bounds, search.lists, search.near, search.spans
    surface, out = search.surface, search.out
    for a in range(active.shape[0]):
        first, last = lists.spans[lists.row[active[a]]]
        spans[a, 0], spans[a, 1] = first, last
        listed = lists.listed[first:last]
        _combine(search.calls[_COMBINE], (x, surface.nodes, surface.weights, listed, search.places))
    poses, asked = ShapePoses(bounds.position, bounds.rotation), PointLists(active, spans, lists.listed)
    hits = HitRows(near.point, near.shape, out)
    count = _points_near(search.calls[_POINTS], (search.places, bounds.shapes, poses, asked, reach, hits))
    for k in range(count):
        near.distance[k] = out[k, 0]
        for r in range(3):
            near.normal[k, r] = out[k, 1 + r]
    return count


@device_function
def _find_features(x: Matrix, low: Vector, high: Vector, reach: float, behind: float, search: Any) -> int:
    """Fill the features that are near the film; return how many."""
    bounds, lists, near, out = search.bounds, search.lists, search.near, search.out
    for r in range(3):
        search.box[0, r], search.box[1, r] = low[r] - reach, high[r] + reach
    around, found = search.around, search.found
    carried = bounds.position, bounds.rotation, search.owner, search.feature, lists.features, around
    _carry(search.calls[_CARRY], carried)
    film, listed = FilmTriangles(x, search.surface.triangles), TriangleLists(lists.first, lists.triangles)
    within, hits = (
        FilmReach(reach, behind, search.box[0], search.box[1]),
        FeatureRows(found, near.triangle, near.weight, out),
    )
    count = _film_near(search.calls[_FILM], (around, film, listed, within, search.held, hits))
    for k in range(count):
        near.feature[k], near.owner[k] = lists.features[found[k]], search.owner[lists.features[found[k]]]
        near.film_distance[k] = out[k, 0]
        for r in range(3):
            near.place[k, r], near.film_normal[k, r] = around[found[k], r], out[k, 1 + r]
    return count


@kernel
def find_near(
    x: Matrix, low: Vector, high: Vector, active: Indices, reach: float, behind: float, search: Search
) -> tuple[int, int]:
    """Fill what is near; return how many points of the film and how many features, -1 for lists too old.

    Args:
        x: (n, 3) [m], of the nodes.
        low: (3,) [m], smallest coordinates of the film.
        high: (3,) [m], largest ones.
        active: (a,) shapes that may be near it.
        reach: bound on the distance [m].
        behind: how far behind the film a feature still counts [m].
        search: filled.
    """
    lists, bounds = search.lists, search.bounds
    gone = _gone(x, bounds.position, bounds.rotation, active, lists.row, lists.local)
    if not (reach + gone <= lists.reach_m and behind + gone <= lists.behind_m):
        return -1, -1
    points = _find_points(x, active, reach, search)
    return points, _find_features(x, low, high, reach, behind, search)
