"""Signed distance and normal from many points to many shapes of every kind, broad phase included."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import (
    BLOCKS,
    BOOLEAN,
    INDEX_TABLE,
    INDICES,
    INTEGER,
    MATRIX,
    REAL,
    VECTOR,
    device_function,
    kernel,
    small_vector,
)
from cosim.rigid.distance.mesh_distance import FAR, grid, hull
from cosim.rigid.distance.primitive_distance import box, capsule, cylinder, ellipsoid, plane, sphere
from cosim.rigid.distance.shapes import Shapes


@device_function
def _distance(kind, p, size, reach, planes, corners, values, table, origin, spacing, weight, normal):  # type: ignore[no-untyped-def]
    if kind == 0:
        return plane(p[0], p[1], p[2], size, normal)
    if kind == 2:
        return sphere(p[0], p[1], p[2], size, normal)
    if kind == 3:
        return capsule(p[0], p[1], p[2], size, normal)
    if kind == 4:
        return ellipsoid(p[0], p[1], p[2], size, normal)
    if kind == 5:
        return cylinder(p[0], p[1], p[2], size, normal)
    if kind == 6:
        return box(p[0], p[1], p[2], size, normal)
    if kind == 7:
        return hull(p, planes, corners, reach, weight, normal)
    if kind == 8:
        nx, ny, nz = table[1], table[2], table[3]
        distances = values[table[0] : table[0] + nx * ny * nz].reshape((nx, ny, nz))
        return grid(p, distances, origin, spacing, normal)
    return FAR


@kernel(
    INTEGER(
        MATRIX, REAL, BOOLEAN, INDICES, INDEX_TABLE, INDICES, MATRIX, BLOCKS, INDICES, MATRIX, MATRIX, MATRIX,
        INDEX_TABLE, MATRIX, BLOCKS, INDEX_TABLE, MATRIX, MATRIX, VECTOR, INDICES, INDICES, MATRIX,
    )
)  # fmt: skip
def points_near(  # type: ignore[no-untyped-def]
    points, reach, boxes, active, spans, listed, position, rotation, kind, size, center, half, faces, planes,
    corners, table, origin, spacing, values, out_point, out_shape, out,
):  # fmt: skip
    """Fill the pairs nearer than `reach`: indices, distance and world normal; return how many.

    Asked for are active[a] with each of listed[spans[a, 0]] .. listed[spans[a, 1] - 1]. With `boxes` a point
    that is nearer than that to the bounding box of a grid counts as well.
    """
    count = 0
    p, normal, weight, bound = small_vector(3), small_vector(3), small_vector(3), small_vector(3)
    for a in range(active.shape[0]):
        g = active[a]
        first, last = faces[g, 0], faces[g, 1]
        turn, place, extent = rotation[g], position[g], size[g]
        own_planes, own_corners = planes[first:last], corners[first:last]
        own_table, own_origin, own_spacing = table[g], origin[g], spacing[g]
        for r in range(3):
            bound[r] = half[g, r] + reach
        for k in range(spans[a, 0], spans[a, 1]):
            n = listed[k]
            dx, dy, dz = points[n, 0] - place[0], points[n, 1] - place[1], points[n, 2] - place[2]
            outside = False
            for r in range(3):
                p[r] = turn[0, r] * dx + turn[1, r] * dy + turn[2, r] * dz
                if not abs(p[r] - center[g, r]) < bound[r]:
                    outside = True
                    break
            if outside:
                continue
            distance = _distance(
                kind[g], p, extent, reach, own_planes, own_corners, values, own_table, own_origin,
                own_spacing, weight, normal,
            )  # fmt: skip
            if distance < reach or (boxes and kind[g] == 8):
                out_point[count], out_shape[count], out[count, 0] = n, g, distance
                for r in range(3):
                    out[count, 1 + r] = (
                        turn[r, 0] * normal[0] + turn[r, 1] * normal[1] + turn[r, 2] * normal[2]
                    )
                count += 1
    return count


@final
@dataclass(frozen=True)
class Hits:
    """Pairs of a point and a shape that are near each other.

    Args:
        point: (k,) index of the point.
        shape: (k,) index of the shape.
        distance: (k,) [m], negative inside the shape.
        normal: (k, 3), outward unit normal of the shape at its nearest surface point, world.
    """

    point: IntArray
    shape: IntArray
    distance: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.point)


@final
@dataclass(frozen=True)
class PointLists:
    """Points asked for, shape by shape: listed[spans[a, 0]] .. listed[spans[a, 1] - 1] of the a-th one.

    Args:
        spans: (a, 2).
        listed: (k,) indices of points.
    """

    spans: IntArray
    listed: IntArray

    @classmethod
    def whole(cls, points: int, shapes: int) -> PointLists:
        """Return all points for each of the shapes."""
        return cls(np.tile([0, points], (shapes, 1)), np.arange(points))

    @classmethod
    def around(
        cls, shapes: Shapes, position: Array, rotation: Array, points: Array, reach_m: float, active: IntArray
    ) -> PointLists:
        """Return, for each active shape, all points that come within `reach_m` of it, and some others.

        Arguments as of `near_points`.
        """
        lists = cls.whole(len(points), len(active))
        # what a grid says of points that are not close to its surface is no bound on their distance
        hits = _near(shapes, position, rotation, points, reach_m, active, lists, boxes=True)
        ends = np.cumsum(np.bincount(hits.shape, minlength=len(shapes.kind))[active])
        return cls(np.column_stack([ends - np.diff(ends, prepend=0), ends]), hits.point.copy())


def near_points(
    shapes: Shapes,
    position: Array,
    rotation: Array,
    points: Array,
    reach_m: float,
    active: IntArray,
    lists: PointLists | None = None,
) -> Hits:
    """Return every pair of a point and an active shape with a signed distance below `reach_m`.

    Args:
        shapes: in their own frames.
        position: (g, 3) [m], of the shapes' frames, world.
        rotation: (g, 3, 3), world from shape.
        points: (n, 3) [m], world, C-contiguous.
        reach_m: bound [m].
        active: (a,) shapes asked for.
        lists: points asked for of each; all unless given.
    """
    if lists is None:
        lists = PointLists.whole(len(points), len(active))
    return _near(shapes, position, rotation, points, reach_m, active, lists)


def _near(
    s: Shapes,
    position: Array,
    rotation: Array,
    points: Array,
    reach_m: float,
    active: IntArray,
    lists: PointLists,
    *,
    boxes: bool = False,
) -> Hits:
    room = int((lists.spans[:, 1] - lists.spans[:, 0]).sum())
    point, shape = np.empty(room, np.int64), np.empty(room, np.int64)
    out = np.empty((room, 4))
    count = points_near(
        points, reach_m, boxes, active, lists.spans, lists.listed, position, rotation, s.kind, s.size,
        s.center, s.half, s.faces, s.planes, s.corners, s.table, s.origin, s.spacing, s.values, point, shape,
        out,
    )  # fmt: skip
    distance, normal = out[:count, 0].copy(), out[:count, 1:].copy()
    return Hits(point[:count], shape[:count], distance, normal)
