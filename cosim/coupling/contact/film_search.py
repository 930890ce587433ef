"""One kernel that finds film and shapes near each other, through lists that serve until the film has moved.

A shape does not move in its own frame. So while no node of the film has gone further there than m since the
lists were made, what is nearer than r now was nearer than r + m then: points of the film to the shape, the
shape's sharp features to triangles of the film.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from __future__ import annotations

import numpy as np
from numba import types

from cosim.base.frames import IntArray
from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import INDICES, MATRIX, REAL, VECTOR, device_function, kernel
from cosim.coupling.contact.contact_arrays import SEARCH
from cosim.rigid.distance.features import carry
from cosim.rigid.distance.film_distance import film_near
from cosim.rigid.distance.signed_distance import points_near
from cosim.soft.contact.point_kernels import combine

_CALLED = (combine, points_near, carry, film_near)
_COMBINE, _POINTS, _CARRY, _FILM = range(len(_CALLED))
_combine, _points_near, _carry, _film_near = map(caller, _CALLED)


def search_calls() -> IntArray:
    """Return the addresses (4,) of the kernels that a search calls."""
    return np.array([address_of(called) for called in _CALLED])


@device_function
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


@device_function
def _find_points(x, active, reach, search):  # type: ignore[no-untyped-def]
    """Fill the points of the film that are near active shapes; return how many."""
    bounds, shapes, lists, near, spans = search.bounds, search.shapes, search.lists, search.near, search.spans
    surface, out = search.surface, search.out
    for a in range(active.shape[0]):
        first, last = lists.spans[lists.row[active[a]]]
        spans[a, 0], spans[a, 1] = first, last
        listed = lists.listed[first:last]
        _combine(search.calls[_COMBINE], (x, surface.nodes, surface.weights, listed, search.places))
    count = _points_near(
        search.calls[_POINTS],
        (
            search.places, reach, False, active, spans, lists.listed, bounds.position, bounds.rotation,
            bounds.kind, shapes.size, bounds.center, bounds.half, shapes.faces, shapes.planes, shapes.corners,
            shapes.table, shapes.origin, shapes.spacing, shapes.values, near.point, near.shape, out,
        ),
    )  # fmt: skip
    for k in range(count):
        near.distance[k] = out[k, 0]
        for r in range(3):
            near.normal[k, r] = out[k, 1 + r]
    return count


@device_function
def _find_features(x, low, high, reach, behind, search):  # type: ignore[no-untyped-def]
    """Fill the features that are near the film; return how many."""
    bounds, lists, near, out = search.bounds, search.lists, search.near, search.out
    for r in range(3):
        search.box[0, r], search.box[1, r] = low[r] - reach, high[r] + reach
    around, found = search.around, search.found
    carried = bounds.position, bounds.rotation, search.owner, search.feature, lists.features, around
    _carry(search.calls[_CARRY], carried)
    box, triangles = (search.box[0], search.box[1]), search.surface.triangles
    asked = around, *box, x, triangles, lists.first, lists.triangles, search.held, reach, behind
    count = _film_near(search.calls[_FILM], (*asked, found, near.triangle, near.weight, out))
    for k in range(count):
        near.feature[k], near.owner[k] = lists.features[found[k]], search.owner[lists.features[found[k]]]
        near.film_distance[k] = out[k, 0]
        for r in range(3):
            near.place[k, r], near.film_normal[k, r] = around[found[k], r], out[k, 1 + r]
    return count


@kernel(types.UniTuple(types.int64, 2)(MATRIX, VECTOR, VECTOR, INDICES, REAL, REAL, SEARCH))
def find_near(x, low, high, active, reach, behind, search):  # type: ignore[no-untyped-def]
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
