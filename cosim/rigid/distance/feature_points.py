"""Corners of obstacles, and points on their sharp edges. Contact points of the film alone would miss edges
that enter between its nodes.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Indices, Matrix
from cosim.base.kernels import kernel
from cosim.rigid.distance.shapes import ShapeKind, Shapes

_SPACING_M = 4e-3  # of points along sharp edges
_MOST_PIECES = 2_500  # of an edge or a rim; above 10 m the spacing is larger
_SHARP_COSINE = np.cos(np.radians(20.0))  # faces of a hull with a smaller angle have no edge


@kernel
def carry(
    position: Matrix, rotation: Blocks, owner: Indices, local: Matrix, chosen: Indices, out: Matrix
) -> None:
    """Fill the world positions of chosen points.

    Args:
        position: (g, 3) [m], of all shapes' frames, world.
        rotation: (g, 3, 3), world from shape.
        owner: (k,), shape of each point.
        local: (k, 3) [m], points in the frames of their shapes.
        chosen: (c,), indices of points.
        out: (c, 3) [m], filled.
    """
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
        """Return the positions (k, 3) [m], world, of chosen points.

        Args:
            position: (g, 3) [m], of all shapes' frames, world.
            rotation: (g, 3, 3), world from shape.
            chosen: (k,), indices of points.
        """
        out = np.empty((len(chosen), 3))
        carry(position, rotation, self.shape, self.position, chosen, out)
        return out


def feature_points(shapes: Shapes) -> FeaturePoints:
    """Return the corners of all shapes, and points along their edges and rims."""
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
