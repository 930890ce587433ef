"""Shapes that a soft body may touch: their bounds, which of them are near, their corners and edges.

Bounds of the shapes of a scene as kernels see them.

Corners of obstacles, and points on their edges: points of the film alone miss what enters between them.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
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
    """Where the frames of g shapes are.

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
    """Fill the indices of the shapes whose bounds come within `reach` of a box; return how many.

    A shape's bounding box turns with it; its extent along a world axis r is sum_s |R_rs| half_s. A plane is
    near when the lowest corner of the box along its normal is.
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
    """Where MuJoCo has the geoms of shapes; its arrays stay where they are in memory.

    Args:
        geoms: (g,), places in MuJoCo's arrays.
        body: (g,), of each shape.
        places: (geoms, 3) [m], world.
        axes: (geoms, 9), world from geom.
    """

    geoms: Indices
    body: Indices
    places: Matrix
    axes: Matrix


_SPACING_M = 4e-3  # of points along sharp edges
_MOST_PIECES = 2_500  # of an edge or a rim: on those of more than 10 m points are further apart
_SHARP_COSINE = np.cos(np.radians(20.0))  # hull edges below this turn are no edges


@kernel
def carry(
    position: Matrix, rotation: Blocks, owner: Indices, local: Matrix, chosen: Indices, out: Matrix
) -> None:
    """Fill where chosen points, given in the frames of their shapes, are in the world."""
    for k in range(chosen.shape[0]):
        p = local[chosen[k]]
        turn, place = rotation[owner[chosen[k]]], position[owner[chosen[k]]]
        for r in range(3):
            out[k, r] = place[r] + (turn[r, 0] * p[0] + turn[r, 1] * p[1] + turn[r, 2] * p[2])


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

    def carried(self, position: Array, rotation: Array, chosen: IntArray) -> Array:
        """Return where chosen points (k,) are (k, 3) [m], world.

        Args:
            position: (g, 3) [m], of all shapes' frames.
            rotation: (g, 3, 3), world from shape.
            chosen: indices of points.
        """
        out = np.empty((len(chosen), 3))
        carry(position, rotation, self.shape, self.position, chosen, out)
        return out


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


def _pieces(length_m: float, fewest: int) -> int:
    return int(np.clip(np.ceil(length_m / _SPACING_M), fewest, _MOST_PIECES))


def _along(a: Array, b: Array) -> Array:
    pieces = _pieces(float(np.linalg.norm(b - a)), 1)
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
    turn = np.arange(_pieces(2.0 * np.pi * radius, 8), dtype=np.float64)
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
