"""Candidates of self-contact: pairs of points and triangles that are near one another, found by boxes.

A point over a triangle in the sense of `self_contact_search` is at most `room` from its foot, and the foot is
at most 2 b e from the triangle's bounding box, with e the longest edge and b the weight by which a foot may
lie beyond an edge. Boxes around groups of points, and around groups of triangles, are compared first.
"""

from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector
from cosim.soft.contact import triangle_foot
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints, Relation

BEYOND_EDGES: Final = 0.02
"""Barycentric weight by which a foot may lie outside of a triangle, so that no point falls between two."""
VALLEY: Final = int(Relation.VALLEY)
_POINTS_OF_BOX, _TRIANGLES_OF_BOX = 16, 16


class FilmRows(NamedTuple):
    """Points and triangles of a film.

    Args:
        nodes: (p, 3), nodes of each point's triangle.
        weights: (p, 3), barycentric.
        homes: (p, 2) face and unit of each point.
        spare: (p,) [m], added to distances of each point, see `contact_law.spare`.
        start: (p + 1,), start of each point's entries in `around`.
        around: triangles around the points.
        triangles: (t, 3).
        films: (t, 2), face and unit of each.
        relation: (faces, faces), see `Relation`.
    """

    nodes: IndexTable
    weights: Matrix
    homes: IndexTable
    spare: Vector
    start: Indices
    around: Indices
    triangles: IndexTable
    films: IndexTable
    relation: IndexTable

    @classmethod
    def of(cls, faces: FilmFaces, points: FilmPoints) -> "FilmRows":
        """Return the rows of a film."""
        films = np.column_stack([faces.face, faces.unit])
        point = points.nodes, points.weights, points.home, np.zeros(len(points)), *points.around
        return cls(*point, faces.triangles, films, faces.relation)


class BoxRows(NamedTuple):
    """Groups of points, and of triangles, of a film; each group is of one face and has a box.

    Args:
        order: (p,) points, neighbours together.
        points_from: (a + 1,), start of each group in `order`.
        triangle_order: (t,) triangles, neighbours together.
        triangles_from: (c + 1,), start of each group in `triangle_order`.
    """

    order: Indices
    points_from: Indices
    triangle_order: Indices
    triangles_from: Indices

    @classmethod
    def of(cls, rows: FilmRows, positions: Array) -> "BoxRows":
        """Return the groups of a film, from its drawn nodes (n, 3) [m]."""
        points = (rows.weights[:, :, None] * positions[rows.nodes]).sum(axis=1)
        order = _neighbours(rows.homes[:, 0], points)
        triangle_order = _neighbours(rows.films[:, 0], positions[rows.triangles].mean(axis=1))
        return cls(
            order,
            _runs(rows.homes[order, 0], _POINTS_OF_BOX),
            triangle_order,
            _runs(rows.films[triangle_order, 0], _TRIANGLES_OF_BOX),
        )


def _neighbours(face: IntArray, points: Array) -> IntArray:
    """Return the order of points (k, 3) of faces (k,) along a Morton curve in each face."""
    low = points.min(axis=0)
    cells = ((points - low) * (1023.0 / max(float(np.ptp(points, axis=0).max()), 1e-12))).astype(np.int64)
    bits = (cells[:, :, None] >> np.arange(10)) & 1
    return np.lexsort(((bits << (3 * np.arange(10) + np.arange(3)[:, None])).sum(axis=(1, 2)), face))


def _runs(face: IntArray, longest: int) -> IntArray:
    """Return the starts (k + 1,) of runs of one face, none longer than `longest`, and the end of the last."""
    ends = [0, *(1 + np.flatnonzero(np.diff(face))).tolist(), len(face)]
    return np.array([*(k for a, b in pairwise(ends) for k in range(a, b, longest)), len(face)], np.int64)


@device_function
def _enclose(boxes: Matrix, begin: int, end: int, around: Vector) -> None:
    """Fill the box (6,), smallest and largest coordinates, around some boxes."""
    for r in range(3):
        around[r], around[3 + r] = np.inf, -np.inf
        for k in range(begin, end):
            around[r], around[3 + r] = min(around[r], boxes[k, r]), max(around[3 + r], boxes[k, 3 + r])


@device_function
def square_between(
    boxes: Matrix, k: int, x: float, y: float, z: float, u: float, v: float, w: float
) -> float:
    """Return the squared distance of box k from the box with corners (x, y, z) and (u, v, w)."""
    along = max(boxes[k, 0] - u, x - boxes[k, 3], 0.0)
    across = max(boxes[k, 1] - v, y - boxes[k, 4], 0.0)
    beyond = max(boxes[k, 2] - w, z - boxes[k, 5], 0.0)
    return along * along + across * across + beyond * beyond


@device_function
def _list_point(
    rows: FilmRows, p: int, near: tuple[Indices, Vector], limit: float, listed: Indices, total: int
) -> int:
    """Add the triangles of a point to the list; return the new number of entries.

    `near` holds the triangles' indices, doubled, plus 1 across a valley, and their squared distances.
    """
    triangles, squares = near
    for entry in range(triangles.shape[0]):
        t, lists = triangles[entry] >> 1, squares[entry] <= limit
        if lists and triangles[entry] & 1:  # a point does not touch triangles of its own nodes
            for a in range(3):
                for b in range(3):
                    lists &= rows.nodes[p, a] != rows.triangles[t, b]
        if total < listed.shape[0]:
            listed[total] = t
        total += 1 if lists else 0
    return total


@device_function
def _find_near(
    rows: FilmRows,
    boxes: BoxRows,
    face: int,
    box: Vector,
    around: tuple[Matrix, Matrix],
    limit: float,
    near_triangles: Indices,
) -> int:
    """Fill the triangles near a box of a face, of faces that can meet that face; return their number."""
    triangles, bundles = around
    corners, count = (box[0], box[1], box[2], box[3], box[4], box[5]), 0
    for k in range(bundles.shape[0]):
        begin, end = boxes.triangles_from[k], boxes.triangles_from[k + 1]
        other_face = rows.films[boxes.triangle_order[begin], 0]
        if rows.relation[face, other_face] != 0 and square_between(bundles, k, *corners) <= limit:
            for k_triangle in range(begin, end):
                if square_between(triangles, k_triangle, *corners) <= limit:
                    near_triangles[count] = k_triangle
                    count += 1
    return count


@device_function
def _fill_squares(columns: Matrix, count: int, point: Vector, squares: Vector) -> None:
    """Fill the squared distances of the first boxes from a point, in one loop without branches for speed."""
    x, y, z = point[0], point[1], point[2]
    for e in range(count):
        along = max(columns[0, e] - x, x - columns[3, e], 0.0)
        across = max(columns[1, e] - y, y - columns[4, e], 0.0)
        beyond = max(columns[2, e] - z, z - columns[5, e], 0.0)
        squares[e] = along * along + across * across + beyond * beyond


@device_function
def _fill_box(x: Matrix, corners: Indices, above: float, box: Vector) -> None:
    """Fill the box (6,) around a triangle, extended along its normal to both sides."""
    a, b, c, normal = corners[0], corners[1], corners[2], small_vector(3)
    if above > 0.0:
        triangle_foot.plane_of(x, corners, normal)
    for r in range(3):
        box[r], box[3 + r] = min(x[a, r], x[b, r], x[c, r]), max(x[a, r], x[b, r], x[c, r])
        further = above * abs(normal[r])
        if further > 0.0:  # NaN for a triangle without area
            box[r], box[3 + r] = box[r] - further, box[3 + r] + further


@kernel(allocates=True)
def fill_list(
    x: Matrix, rows: FilmRows, boxes: BoxRows, bounds: tuple[float, float], first: Indices, listed: Indices
) -> int:
    """Fill each point's triangles; return their total number.

    Entries beyond the size of the list are only counted. For an empty list the result is an upper bound.

    Args:
        x: (n, 3) [m].
        rows: of the film.
        boxes: of the film.
        bounds: largest distance of a point from the box of a triangle, and extension of that box along the
            normal, on both sides [m].
        first: (p + 1,), start of each point's triangles, in the order of the boxes; filled.
        listed: filled.
    """
    points, triangles = np.empty((rows.nodes.shape[0], 6)), np.empty((rows.triangles.shape[0], 6))
    bundles, box_of_points = np.empty((boxes.triangles_from.shape[0] - 1, 6)), np.empty(6)
    near_triangles, total, limit = np.empty(triangles.shape[0], np.int64), 0, bounds[0] * bounds[0]
    columns, squares = np.empty((6, triangles.shape[0])), np.empty(triangles.shape[0])
    for k in range(points.shape[0]):  # boxes of points have no size
        triangle_foot.fill_point(x, rows.nodes[boxes.order[k]], rows.weights[boxes.order[k]], points[k])
        for r in range(3):
            points[k, 3 + r] = points[k, r]
    for k in range(triangles.shape[0]):
        _fill_box(x, rows.triangles[boxes.triangle_order[k]], bounds[1], triangles[k])
    for k in range(bundles.shape[0]):
        _enclose(triangles, boxes.triangles_from[k], boxes.triangles_from[k + 1], bundles[k])
    for box in range(boxes.points_from.shape[0] - 1):
        begin, end = boxes.points_from[box], boxes.points_from[box + 1]
        _enclose(points, begin, end, box_of_points)
        face = rows.homes[boxes.order[begin], 0]
        near_count = _find_near(rows, boxes, face, box_of_points, (triangles, bundles), limit, near_triangles)
        if listed.shape[0] == 0:
            total += near_count * (end - begin)
            continue
        for e in range(near_count):
            for r in range(6):
                columns[r, e] = triangles[near_triangles[e], r]
            t = boxes.triangle_order[near_triangles[e]]
            near_triangles[e] = 2 * t + (rows.relation[face, rows.films[t, 0]] == VALLEY)
        for k in range(begin, end):
            first[k] = total
            _fill_squares(columns, near_count, points[k], squares)
            total = _list_point(
                rows, boxes.order[k], (near_triangles[:near_count], squares), limit, listed, total
            )
    first[rows.nodes.shape[0]] = total
    return total


@kernel
def foot_beside(x: Matrix, triangles: IndexTable) -> float:
    """Return the largest distance of a valid foot on a triangle from its bounding box."""
    longest = 0.0
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            u, v, w = x[a, 0] - x[b, 0], x[a, 1] - x[b, 1], x[a, 2] - x[b, 2]
            longest = max(longest, u * u + v * v + w * w)
    return 2.0 * BEYOND_EDGES * np.sqrt(longest)
