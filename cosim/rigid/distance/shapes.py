"""Shapes that a soft body may touch, and which of them are near; what is far needs no distances."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDICES, INTEGER, MATRIX, REAL, VECTOR, kernel


class ShapeKind(IntEnum):
    """Kinds of shapes, numbered as MuJoCo numbers its geoms."""

    PLANE = 0
    SPHERE = 2
    CAPSULE = 3
    ELLIPSOID = 4
    CYLINDER = 5
    BOX = 6
    MESH = 7
    GRID = 8


@final
@dataclass(frozen=True)
class Shapes:
    """Shapes in their own frames; data of hulls and grids lie end to end.

    Args:
        kind: (g,) values of `ShapeKind`.
        size: (g, 3) [m], as MuJoCo's geoms have it.
        center: (g, 3) [m], of the bounding box.
        half: (g, 3) [m], half edges of the bounding box; infinite for planes.
        faces: (g, 2) first and one past the last hull face.
        planes: (f, 4) outward unit normal and offset [m] of the hull faces.
        corners: (f, 3, 3) [m], of the hull faces.
        table: (g, 4) first entry in `values`, then the grid's shape.
        origin: (g, 3) [m], of the grid.
        spacing: (g, 3) [m], of the grid.
        values: distances [m].
    """

    kind: IntArray
    size: Array
    center: Array
    half: Array
    faces: IntArray
    planes: Array
    corners: Array
    table: IntArray
    origin: Array
    spacing: Array
    values: Array


@kernel(INTEGER(INDICES, MATRIX, MATRIX, MATRIX, BLOCKS, VECTOR, VECTOR, REAL, INDICES))
def fill_near_box(kind, center, half, position, rotation, low, high, reach, near):  # type: ignore[no-untyped-def]
    """Fill the indices of the shapes whose bounds come within `reach` of a box; return how many."""
    count = 0
    for g in range(kind.shape[0]):
        apart = False
        if kind[g] == 0:
            height = 0.0
            for r in range(3):
                normal = rotation[g, r, 2]
                height += normal * ((low[r] if normal > 0.0 else high[r]) - position[g, r])
            apart = height >= reach
        else:
            for r in range(3):
                middle, extent = position[g, r], reach
                for s in range(3):
                    middle += rotation[g, r, s] * center[g, s]
                    extent += abs(rotation[g, r, s]) * half[g, s]
                if low[r] > middle + extent or high[r] < middle - extent:
                    apart = True
        if not apart:
            near[count] = g
            count += 1
    return count


def near_box(
    shapes: Shapes, position: Array, rotation: Array, low: Array, high: Array, reach_m: float
) -> IntArray:
    """Return the shapes whose bounds come within `reach_m` of an axis-aligned box (broad phase).

    A shape's bounding box turns with it; its extent along a world axis r is sum_s |R_rs| half_s. A plane is
    near when the lowest corner of the box along its normal is.

    Args:
        shapes: in their own frames.
        position: (g, 3) [m], world.
        rotation: (g, 3, 3), world from shape.
        low: (3,) [m], smallest coordinates of the box.
        high: (3,) [m], largest coordinates of the box.
        reach_m: [m].
    """
    near = np.empty(len(shapes.kind), np.int64)
    count = fill_near_box(
        shapes.kind, shapes.center, shapes.half, position, rotation, low, high, reach_m, near
    )
    return near[:count]
