"""One kernel that finds film and shapes near each other, through lists that serve until the film has moved.

A shape does not move in its own frame. So while no node of the film has gone further there than m since the
lists were made, what is nearer than r now was nearer than r + m then: points of the film to the shape, the
shape's sharp features to triangles of the film.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import (
    BLOCKS,
    INDEX_TABLE,
    INDICES,
    MATRIX,
    REAL,
    VECTOR,
    address_of,
    device_function,
    kernel,
)
from cosim.base.numba_insides import caller
from cosim.coupling.contact.contact_arrays import NEAR, SURFACE, NearPoints, SurfaceRows
from cosim.rigid.distance.features import carry
from cosim.rigid.distance.film_distance import film_near
from cosim.rigid.distance.shape_bounds import SHAPE_BOUNDS, ShapeBounds
from cosim.rigid.distance.signed_distance import points_near
from cosim.soft.contact.point_kernels import combine

_CALLED = (combine, points_near, carry, film_near)
_COMBINE, _POINTS, _CARRY, _FILM = range(len(_CALLED))
_combine, _points_near, _carry, _film_near = map(caller, _CALLED)


def search_calls() -> IntArray:
    """Return the addresses (4,) of the kernels that a search calls."""
    return np.array([address_of(called) for called in _CALLED])


class ListRows(NamedTuple):
    """What was near when the lists were made.

    Args:
        row: (g,) of each shape in the arrays that follow; -1 for one that was too far.
        local: (s, n, 3) [m], the nodes then, in the frames of s shapes.
        reach_m: distance to which the lists hold.
        behind_m: the same for features behind the film.
        spans: (s, 2), and
        listed: (k,), see `PointLists`: points of the film, for each of the s shapes.
        features: (f,) that were near a triangle.
        first: (f + 1,), and
        triangles: (t,), see `TriangleLists`: of the film, for each of these.
    """

    row: IntArray
    local: Array
    reach_m: float
    behind_m: float
    spans: IntArray
    listed: IntArray
    features: IntArray
    first: IntArray
    triangles: IntArray


class ShapeSurfaces(NamedTuple):
    """Fields of `Shapes` beside those of `ShapeBounds`."""

    size: Array
    faces: IntArray
    planes: Array
    corners: Array
    table: IntArray
    origin: Array
    spacing: Array
    values: Array


class Search(NamedTuple):
    """What a search is given, and what it fills; scratch is as long as the lists.

    Args:
        bounds: of the shapes.
        shapes: their surfaces.
        owner: (features,) shape of each feature.
        feature: (features, 3) [m], shape frame.
        surface: of the film.
        lists: that may serve.
        near: filled from the beginning.
        held: (f,) the triangle that has held each listed feature back until now, -1 for none.
        places: (p, 3) [m], of the film's points; those that no shape is near may be anywhere.
        spans: (s, 2).
        around: (f, 3) [m], where listed features are.
        found: (f,), which of them are near.
        out: (k, 4), distance and normal.
        box: (2, 3) [m], outside of which no feature counts.
        calls: (4,), see `search_calls`.
    """

    bounds: ShapeBounds
    shapes: ShapeSurfaces
    owner: IntArray
    feature: Array
    surface: SurfaceRows
    lists: ListRows
    near: NearPoints
    held: IntArray
    places: Array
    spans: IntArray
    around: Array
    found: IntArray
    out: Array
    box: Array
    calls: IntArray


LISTS = types.NamedTuple(
    (INDICES, BLOCKS, REAL, REAL, INDEX_TABLE, INDICES, INDICES, INDICES, INDICES), ListRows
)
_SHAPES = types.NamedTuple(
    (MATRIX, INDEX_TABLE, MATRIX, BLOCKS, INDEX_TABLE, MATRIX, MATRIX, VECTOR), ShapeSurfaces
)
SEARCH = types.NamedTuple(
    (
        SHAPE_BOUNDS, _SHAPES, INDICES, MATRIX, SURFACE, LISTS, NEAR, INDICES, MATRIX, INDEX_TABLE, MATRIX,
        INDICES, MATRIX, MATRIX, INDICES,
    ),
    Search,
)  # fmt: skip


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
