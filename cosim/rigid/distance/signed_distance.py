"""Signed distances from many points to shapes of every kind: finds the pairs of a point and a shape that are
nearer than a bound.
"""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector
from cosim.rigid.distance.primitives import box, cylinder, ellipsoid, from_center_line
from cosim.rigid.distance.shapes import ShapeKind, ShapePoses, Shapes
from cosim.rigid.distance.surfaces import FAR, grid, hull

_BOUNDS = 9  # kind of a shape whose distance is -FAR within its bounding box


@device_function
def _distance(shapes: Shapes, g: int, p: Vector, reach: float, weight: Vector, normal: Vector) -> float:
    """Return the signed distance of p (3,) [m], in the frame of shape g, to the shape; weight is scratch."""
    kind, size = shapes.kind[g], shapes.size[g]
    if kind == 0:  # half-space z < 0
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return p[2]
    if kind == 2:
        return from_center_line(p[0], p[1], p[2], size[0], normal)
    if kind == 3:  # radius size[0] about the segment |z| < size[1]
        return from_center_line(p[0], p[1], p[2] - min(max(p[2], -size[1]), size[1]), size[0], normal)
    if kind == 4:
        return ellipsoid(p[0], p[1], p[2], size, normal)
    if kind == 5:
        return cylinder(p[0], p[1], p[2], size, normal)
    if kind == 6:
        return box(p[0], p[1], p[2], size, normal)
    if kind == 7:
        first, last = shapes.faces[g, 0], shapes.faces[g, 1]
        return hull(p, shapes.planes[first:last], shapes.corners[first:last], reach, weight, normal)
    if kind == 8:
        at, nx, ny, nz = shapes.table[g, 0], shapes.table[g, 1], shapes.table[g, 2], shapes.table[g, 3]
        distances = shapes.values[at : at + nx * ny * nz].reshape((nx, ny, nz))
        return grid(p, distances, shapes.origin[g], shapes.spacing[g], normal)
    return -FAR if kind == _BOUNDS else FAR


class PointLists(NamedTuple):
    """Points to test against each shape: listed[spans[a, 0]] .. listed[spans[a, 1] - 1] for shape active[a].

    Args:
        active: (a,) indices of shapes.
        spans: (a, 2), first and one past the last entry of `listed`.
        listed: (k,) indices of points.
    """

    active: Indices
    spans: IndexTable
    listed: Indices

    @classmethod
    def whole(cls, points: int, active: IntArray) -> "PointLists":
        """Return the lists that test all points against each active shape."""
        return cls(active, np.tile([0, points], (len(active), 1)), np.arange(points))

    @classmethod
    def around(
        cls, points: Array, shapes: Shapes, poses: ShapePoses, reach_m: float, active: IntArray
    ) -> "PointLists":
        """Return lists with at least all points within `reach_m` of each active shape.

        Args:
            points: (n, 3) [m], world, C-contiguous.
            shapes: in their frames.
            poses: of the shapes.
            reach_m: bound [m].
            active: (a,) indices of shapes.
        """
        # far from its surface a grid's distance is no bound, so its bounding box is used
        bounds = shapes._replace(kind=np.where(shapes.kind == ShapeKind.GRID, _BOUNDS, shapes.kind))
        hits = near_points(points, bounds, poses, cls.whole(len(points), active), reach_m)
        ends = np.cumsum(np.bincount(hits.shape, minlength=len(shapes.kind))[active])
        return cls(active, np.column_stack([ends - np.diff(ends, prepend=0), ends]), hits.point.copy())


class HitRows(NamedTuple):
    """Output arrays for pairs of a point and a shape.

    Args:
        point: (k,).
        shape: (k,).
        found: (k, 4), distance [m] and world normal.
    """

    point: Indices
    shape: Indices
    found: Matrix


@kernel
def points_near(
    points: Matrix, shapes: Shapes, poses: ShapePoses, lists: PointLists, reach: float, hits: HitRows
) -> int:
    """Fill the pairs of a point and a shape that are nearer than `reach` [m]; return their number."""
    count = 0
    p, normal, weight, bound = small_vector(3), small_vector(3), small_vector(3), small_vector(3)
    for a in range(lists.active.shape[0]):
        g = lists.active[a]
        turn, place = poses.rotation[g], poses.position[g]
        for r in range(3):
            bound[r] = shapes.half[g, r] + reach
        for k in range(lists.spans[a, 0], lists.spans[a, 1]):
            n = lists.listed[k]
            dx, dy, dz = points[n, 0] - place[0], points[n, 1] - place[1], points[n, 2] - place[2]
            outside = False
            for r in range(3):
                p[r] = turn[0, r] * dx + turn[1, r] * dy + turn[2, r] * dz
                if not abs(p[r] - shapes.center[g, r]) < bound[r]:
                    outside = True
                    break
            if outside:
                continue
            distance = _distance(shapes, g, p, reach, weight, normal)
            if distance < reach:
                hits.point[count], hits.shape[count], hits.found[count, 0] = n, g, distance
                for r in range(3):
                    hits.found[count, 1 + r] = (
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


def near_points(points: Array, shapes: Shapes, poses: ShapePoses, lists: PointLists, reach_m: float) -> Hits:
    """Return every pair of a point and a shape with a signed distance below `reach_m`.

    Args:
        points: (n, 3) [m], world, C-contiguous.
        shapes: in their frames.
        poses: of the shapes.
        lists: points to test against each shape.
        reach_m: bound [m].
    """
    room = int((lists.spans[:, 1] - lists.spans[:, 0]).sum())
    rows = HitRows(np.empty(room, np.int64), np.empty(room, np.int64), np.empty((room, 4)))
    count = points_near(points, shapes, poses, lists, reach_m, rows)
    found = rows.found[:count]
    return Hits(rows.point[:count], rows.shape[:count], found[:, 0].copy(), found[:, 1:].copy())
