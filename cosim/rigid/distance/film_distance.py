"""Finds the film triangle nearest to a point, such as a corner of an obstacle, and the side of the film that
the point is on.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector, zero_vector
from cosim.rigid.distance.surfaces import closest_on_triangle

_RUN = 32  # triangles that are passed over together: neighbours mostly follow one another
_TIE = 1e-9  # relative difference of squared distances within which two triangles share the nearest point
# Of the distance, that is height over the plane: within two faces at a right angle it is at least so much.
_SQUARELY = 0.7
_HELD_m = 1e-3  # deeper, an edge of the film has been cut into from its side rather than pressed on a face


@device_function
def _square_to_box(p: Vector, low: Vector, high: Vector) -> float:
    """Return the squared distance of a point from a box."""
    square = 0.0
    for r in range(3):
        beyond = max(low[r] - p[r], p[r] - high[r], 0.0)
        square += beyond * beyond
    return square


@kernel(allocates=True)
def _triangles_around(
    points: Matrix, x: Matrix, triangles: IndexTable, room: float, first: Indices, listed: Indices
) -> int:
    """Fill the triangles whose boxes come within `room` of each point, ascending; return how many there are.

    Those of point n are listed[first[n]] .. listed[first[n + 1] - 1]; none are written beyond the end.
    """
    runs = -(-triangles.shape[0] // _RUN)
    low, high = np.empty((triangles.shape[0], 3)), np.empty((triangles.shape[0], 3))
    lowest, highest = np.full((runs, 3), np.inf), np.full((runs, 3), -np.inf)
    for t in range(triangles.shape[0]):
        for r in range(3):
            a, b, c = x[triangles[t, 0], r], x[triangles[t, 1], r], x[triangles[t, 2], r]
            low[t, r], high[t, r] = min(a, b, c), max(a, b, c)
            lowest[t // _RUN, r] = min(lowest[t // _RUN, r], low[t, r])
            highest[t // _RUN, r] = max(highest[t // _RUN, r], high[t, r])
    total = 0
    for n in range(points.shape[0]):
        first[n] = total
        for run in range(runs):
            if _square_to_box(points[n], lowest[run], highest[run]) > room * room:
                continue
            for t in range(_RUN * run, min(_RUN * (run + 1), triangles.shape[0])):
                if _square_to_box(points[n], low[t], high[t]) > room * room:
                    continue
                if total < listed.shape[0]:
                    listed[total] = t
                total += 1
    first[points.shape[0]] = total
    return total


@device_function
def _fill_normal(a: Vector, b: Vector, c: Vector, normal: Vector) -> None:
    """Fill the normal of a triangle, twice its area long."""
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        normal[r] = (b[s] - a[s]) * (c[q] - a[q]) - (b[q] - a[q]) * (c[s] - a[s])


class FilmTriangles(NamedTuple):
    """The film's surface.

    Args:
        x: (n, 3) [m], of the nodes, world.
        triangles: (m, 3), outward orientation.
    """

    x: Matrix
    triangles: IndexTable


class FilmReach(NamedTuple):
    """Where points count.

    Args:
        front_m: bound on the distance in front of the film.
        depth_m: bound on the distance behind it.
        least: (3,) [m], lowest corner of the box outside of which none does.
        most: (3,) [m], its highest.
    """

    front_m: float
    depth_m: float
    least: Vector = np.full(3, -np.inf)
    most: Vector = np.full(3, np.inf)


class FeatureRows(NamedTuple):
    """Room for pairs of a point and the film triangle nearest to it.

    Args:
        point: (k,).
        triangle: (k,).
        weight: (k, 3), of the nearest point on it.
        found: (k, 4), distance [m] and normal.
    """

    point: Indices
    triangle: Indices
    weight: Matrix
    found: Matrix


class TriangleLists(NamedTuple):
    """Triangles that may be near points: listed[first[n]] .. listed[first[n + 1] - 1] of the n-th one.

    Args:
        first: (k + 1,).
        listed: (at least first[k],) indices of triangles, ascending for each point.
    """

    first: Indices
    listed: Indices

    @classmethod
    def around(cls, points: Array, positions: Array, triangles: IntArray, room_m: float) -> "TriangleLists":
        """Return all that come within `room_m` of the points (k, 3) [m], and some others."""
        first, listed = np.empty(len(points) + 1, np.int64), np.empty(16 * len(points), np.int64)
        while True:
            count = _triangles_around(points, positions, triangles, room_m, first, listed)
            if count <= len(listed):
                return cls(first, listed)
            listed = np.empty(count, np.int64)


@device_function
def _nearest(
    p: Vector, film: FilmTriangles, some: Indices, furthest: float, side: Vector, there: Matrix
) -> tuple[int, float, float]:
    """Return the nearest of some triangles that face a side, its distance and p's height over its plane.

    -1 where none comes within `furthest`; a side of zeros is every side's. There, weights, offset of p from
    the nearest point and normal are filled; the last two rows of its five are scratch.
    """
    weight, normal, x, triangles = there[3], there[4], film.x, film.triangles
    nearest, best, lean = -1, furthest * furthest, 0.0
    bound = furthest * (1.0 + _TIE)
    for t in some:
        a, b, c = x[triangles[t, 0]], x[triangles[t, 1]], x[triangles[t, 2]]
        gap = -np.inf  # by how much p is outside of the triangle's box, along the axis where it is most
        for r in range(3):
            gap = max(gap, min(a[r], b[r], c[r]) - p[r], p[r] - max(a[r], b[r], c[r]))
        if gap > bound:
            continue
        _fill_normal(a, b, c, normal)
        if normal[0] * side[0] + normal[1] * side[1] + normal[2] * side[2] < 0.0:
            continue
        closest_on_triangle(p, a, b, c, weight)
        square, height, area = 0.0, 0.0, 0.0
        for r in range(3):
            d = p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]
            square += d * d
            height += d * normal[r]
            area += normal[r] * normal[r]
        height /= max(np.sqrt(area), 1e-300)
        # where triangles share the nearest point, the one that p lies most squarely over tells the side
        closer = square < best * (1.0 - _TIE)
        if closer or (square <= best * (1.0 + _TIE) and abs(height) > abs(lean)):
            nearest, lean = t, height
            best = min(best, square)
            bound = np.sqrt(best) * (1.0 + _TIE)
            for r in range(3):
                there[0, r], there[2, r] = weight[r], normal[r]
                there[1, r] = p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]
    return nearest, np.sqrt(best), lean


@device_function
def _brushed(
    p: Vector, film: FilmTriangles, some: Indices, furthest: float, faces: tuple[int, int], there: Matrix
) -> tuple[int, float, float]:
    """Return what `_nearest` does of a point behind a face: on the side of another one, if that is opposed.

    Args:
        p: (3,) [m].
        film: its triangles.
        some: of them.
        furthest: bound on the distance [m].
        faces: triangle that the point has brushed, and the nearest one.
        there: filled.
    """
    side, along = small_vector(3), 0.0
    corner, x = film.triangles[faces[0]], film.x
    _fill_normal(x[corner[0]], x[corner[1]], x[corner[2]], side)
    for r in range(3):
        along += side[r] * there[2, r]
    if along >= 0.0:
        side[:] = 0.0
    found = _nearest(p, film, some, furthest, side, there)
    if found[0] < 0:
        side[:] = 0.0
        found = _nearest(p, film, some, furthest, side, there)
    return found


@kernel
def film_near(
    points: Matrix,
    film: FilmTriangles,
    lists: TriangleLists,
    reach: FilmReach,
    held: Indices,
    hits: FeatureRows,
) -> int:
    """Fill each point's nearest triangle if it is within reach; return how many.

    A point that triangle held[n] >= 0 has held back, and that is squarely behind film that faces as this
    does, stays behind it, whatever lies beyond: near a sharp edge of the film the other face is soon nearer,
    and would pull it through. A point that has brushed triangle -2 - held[n] may slip off its edge, to where
    it is in front of another face, but not to behind one that faces the other way.
    """
    side, there = zero_vector(3), small_matrix(5, 3)
    furthest, x = max(reach.front_m, reach.depth_m), film.x
    count = 0
    for n in range(points.shape[0]):
        p, some = points[n], lists.listed[lists.first[n] : lists.first[n + 1]]
        if _square_to_box(p, reach.least, reach.most) > 0.0:
            continue
        stays = False
        if held[n] >= 0:
            corner = film.triangles[held[n]]
            _fill_normal(x[corner[0]], x[corner[1]], x[corner[2]], side)
            nearest, distance, lean = _nearest(p, film, some, furthest, side, there)
            stays = nearest >= 0 and lean < -_SQUARELY * distance and distance < _HELD_m
        if not stays:
            side[:] = 0.0
            nearest, distance, lean = _nearest(p, film, some, furthest, side, there)
            if held[n] <= -2 and nearest >= 0 and lean < 0.0:
                nearest, distance, lean = _brushed(p, film, some, furthest, (-2 - held[n], nearest), there)
        sign = 1.0 if lean >= 0.0 else -1.0
        if nearest < 0 or distance > (reach.front_m if sign > 0.0 else reach.depth_m):
            continue
        size = np.sqrt(there[2, 0] ** 2 + there[2, 1] ** 2 + there[2, 2] ** 2)
        hits.point[count], hits.triangle[count] = n, nearest
        hits.found[count, 0] = sign * distance
        for r in range(3):
            hits.weight[count, r] = there[0, r]
            hits.found[count, 1 + r] = (
                sign * there[1, r] / distance if distance > 1e-8 else there[2, r] / size
            )
        count += 1
    return count
