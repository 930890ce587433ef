"""Corners and points on edges of obstacles, and the film triangles that they meet.

Points of the film alone miss a corner that enters between them, so the sharp features of an
obstacle are tested against the film's triangles as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDEX_TABLE, INDICES, INTEGER, MATRIX, REAL, kernel
from cosim.rigid.distance.mesh_distance import closest_on_triangle
from cosim.rigid.distance.signed_distance import ShapeKind, Shapes

_SPACING_M = 4e-3  # of points along sharp edges
_SHARP_COSINE = np.cos(np.radians(20.0))  # hull edges below this turn are no edges
_TIE = 1e-9  # relative difference of squared distances within which two triangles share the nearest point


@final
@dataclass(frozen=True)
class FeaturePoints:
    """Points on the sharp features of shapes.

    Args:
        shape: (k,) owner of each point.
        position: (k, 3) [m], shape frame.
    """

    shape: IntArray
    position: Array

    def of(self, active: IntArray) -> IntArray:
        """Return the indices of the points that belong to active shapes."""
        chosen = np.zeros(1 + max(self.shape.max(initial=0), active.max(initial=0)), dtype=bool)
        chosen[active] = True
        return np.flatnonzero(chosen[self.shape])


def feature_points(shapes: Shapes) -> FeaturePoints:
    """Return corners, and points along edges and rims, of all shapes that have any."""
    owner, position = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    for g, kind in enumerate(shapes.kind):
        size = shapes.size[g]
        if kind == ShapeKind.BOX:
            points = _box_edges(size)
        elif kind == ShapeKind.CYLINDER:
            points = _rims(size[0], size[1])
        elif kind == ShapeKind.MESH:
            first, last = shapes.faces[g]
            points = _hull_edges(shapes.planes[first:last], shapes.corners[first:last])
        else:
            continue
        owner.append(np.full(len(points), g, dtype=np.int64))
        position.append(points)
    return FeaturePoints(np.concatenate(owner), np.concatenate(position))


def _along(a: Array, b: Array) -> Array:
    pieces = max(1, int(np.ceil(np.linalg.norm(b - a) / _SPACING_M)))
    fraction = np.arange(pieces + 1)[:, None] / pieces
    return np.asarray((1.0 - fraction) * a + fraction * b)


def _unique(points: list[Array]) -> Array:
    merged = np.concatenate(points)
    _, kept = np.unique(np.round(merged / 1e-7).astype(np.int64), axis=0, return_index=True)
    return np.asarray(merged[np.sort(kept)])


def _box_edges(half: Array) -> Array:
    corners = [np.array(s) * half for s in np.ndindex(2, 2, 2)]
    corners = [2.0 * corner - half for corner in corners]
    pairs = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1]
    return _unique([_along(corners[a], corners[b]) for a, b in pairs])


def _rims(radius: float, half: float) -> Array:
    turn = np.arange(max(8, int(np.ceil(2.0 * np.pi * radius / _SPACING_M))), dtype=np.float64)
    turn *= 2.0 * np.pi / len(turn)
    rim = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full_like(turn, half)], axis=1)
    return np.concatenate([rim, rim * (1.0, 1.0, -1.0)])


def _hull_edges(planes: Array, corners: Array) -> Array:
    """Return points along the edges where two faces of a hull meet at a sharp angle."""
    faces: dict[tuple[bytes, bytes], list[int]] = {}
    for f, corner in enumerate(corners):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            first, second = sorted((corner[a].tobytes(), corner[b].tobytes()))
            faces.setdefault((first, second), []).append(f)
    parts = []
    for (first, second), (f, *others) in faces.items():
        if others and planes[f, :3] @ planes[others[0], :3] < _SHARP_COSINE:
            parts.append(_along(np.frombuffer(first), np.frombuffer(second)))
    return _unique(parts) if parts else np.zeros((0, 3))


@kernel(INTEGER(MATRIX, MATRIX, INDEX_TABLE, REAL, REAL, INDICES, INDICES, MATRIX, MATRIX))
def _film_near(points, x, triangles, reach, depth, out_point, out_triangle, out_weight, out):  # type: ignore[no-untyped-def]
    """Fill each point's nearest triangle if the signed distance is in -depth .. reach; return how many."""
    weight, kept, offset, face = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    furthest = max(reach, depth)
    count = 0
    low, high = np.empty((triangles.shape[0], 3)), np.empty((triangles.shape[0], 3))
    for t in range(triangles.shape[0]):
        for r in range(3):
            a, b, c = x[triangles[t, 0], r], x[triangles[t, 1], r], x[triangles[t, 2], r]
            low[t, r], high[t, r] = min(a, b, c), max(a, b, c)
    for n in range(points.shape[0]):
        p = points[n]
        best, nearest, lean, sign = furthest * furthest, -1, 0.0, 1.0
        bound, px, py, pz = furthest * (1.0 + _TIE), p[0], p[1], p[2]
        for t in range(triangles.shape[0]):
            if low[t, 0] - px > bound or px - high[t, 0] > bound:
                continue
            if low[t, 1] - py > bound or py - high[t, 1] > bound:
                continue
            if low[t, 2] - pz > bound or pz - high[t, 2] > bound:
                continue
            a, b, c = x[triangles[t, 0]], x[triangles[t, 1]], x[triangles[t, 2]]
            closest_on_triangle(p, a, b, c, weight)
            square, height, area = 0.0, 0.0, 0.0
            for r in range(3):
                s, q = (r + 1) % 3, (r + 2) % 3
                d = p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]
                m = (b[s] - a[s]) * (c[q] - a[q]) - (b[q] - a[q]) * (c[s] - a[s])
                square += d * d
                height += d * m
                area += m * m
            height /= max(np.sqrt(area), 1e-300)
            # where triangles share the nearest point, the one that p lies most squarely over tells the side
            closer = square < best * (1.0 - _TIE)
            if closer or (square <= best * (1.0 + _TIE) and abs(height) > lean):
                nearest, lean, sign = t, abs(height), 1.0 if height >= 0.0 else -1.0
                best = min(best, square)
                bound = np.sqrt(best) * (1.0 + _TIE)
                for r in range(3):
                    s, q = (r + 1) % 3, (r + 2) % 3
                    kept[r] = weight[r]
                    offset[r] = p[r] - weight[0] * a[r] - weight[1] * b[r] - weight[2] * c[r]
                    face[r] = (b[s] - a[s]) * (c[q] - a[q]) - (b[q] - a[q]) * (c[s] - a[s])
        if nearest < 0:
            continue
        distance = np.sqrt(best)
        if (sign > 0.0 and distance > reach) or (sign < 0.0 and distance > depth):
            continue
        size = np.sqrt(face[0] ** 2 + face[1] ** 2 + face[2] ** 2)
        out_point[count], out_triangle[count] = n, nearest
        out[count, 0] = sign * distance
        for r in range(3):
            out_weight[count, r] = kept[r]
            out[count, 1 + r] = sign * offset[r] / distance if distance > 1e-8 else face[r] / size
        count += 1
    return count


@final
@dataclass(frozen=True)
class SceneHits:
    """Pairs of a feature point and the film triangle nearest to it.

    Args:
        point: (k,) index of the feature point.
        triangle: (k,) index of the triangle.
        weight: (k, 3) barycentric weights of the nearest point on it.
        distance: (k,) [m], negative where the point is behind the film.
        normal: (k, 3), unit, out of the film there.
    """

    point: IntArray
    triangle: IntArray
    weight: Array
    distance: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.point)


def near_film(
    points: Array, positions: Array, triangles: IntArray, reach_m: float, depth_m: float
) -> SceneHits:
    """Return for each point the film triangle nearest to it, where it is near enough.

    Args:
        points: (k, 3) [m], world.
        positions: (n, 3) [m], of the film's nodes, world.
        triangles: (m, 3), outward orientation.
        reach_m: bound on the distance in front of the film.
        depth_m: bound on the distance behind it.
    """
    room = len(points)
    point, triangle = np.empty(room, np.int64), np.empty(room, np.int64)
    weight, out = np.empty((room, 3)), np.empty((room, 4))
    count = _film_near(
        np.ascontiguousarray(points), positions, triangles, reach_m, depth_m, point, triangle, weight, out
    )
    return SceneHits(
        point[:count], triangle[:count], weight[:count], out[:count, 0], np.ascontiguousarray(out[:count, 1:])
    )
