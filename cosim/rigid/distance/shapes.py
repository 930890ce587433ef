"""Shapes that a soft body may touch, as arrays for kernels, and the search for shapes near a box."""

from enum import IntEnum
from typing import NamedTuple

from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import kernel


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


class Shapes(NamedTuple):
    """Shapes in their frames; the data of all hulls and grids are concatenated.

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

    kind: Indices
    size: Matrix
    center: Matrix
    half: Matrix
    faces: IndexTable
    planes: Matrix
    corners: Blocks
    table: IndexTable
    origin: Matrix
    spacing: Matrix
    values: Vector


class ShapePoses(NamedTuple):
    """Poses of g shapes.

    Args:
        position: (g, 3) [m], world.
        rotation: (g, 3, 3), world from shape.
    """

    position: Matrix
    rotation: Blocks


@kernel
def fill_near_box(
    shapes: Shapes, poses: ShapePoses, low: Vector, high: Vector, reach: float, near: Indices
) -> int:
    """Fill the indices of shapes whose bounding box comes within `reach` of a box; return their number.

    The extent of a shape's bounding box along a world axis r is sum_s |R_rs| half_s. A plane is near if the
    box's lowest corner along the plane's normal is.

    Args:
        shapes: in their frames.
        poses: of the shapes.
        low: (3,) [m], smallest corner of the box, world.
        high: (3,) [m], largest corner.
        reach: [m].
        near: (g,), filled.
    """
    kind, center, half, position, rotation = (
        shapes.kind, shapes.center, shapes.half, poses.position, poses.rotation,
    )  # fmt: skip
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


class GeomPoses(NamedTuple):
    """MuJoCo's arrays with the poses of geoms; their memory does not move.

    Args:
        geoms: (g,), rows of the shapes in MuJoCo's arrays.
        body: (g,), body of each shape.
        places: (geoms, 3) [m], world.
        axes: (geoms, 9), world from geom.
    """

    geoms: Indices
    body: Indices
    places: Matrix
    axes: Matrix
