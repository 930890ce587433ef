"""Rigid bodies as lit meshes."""

from __future__ import annotations

from typing import Final

import numpy as np
import rerun as rr
from scipy.sparse import csr_array

from cosim.body_shape import BodyShape
from cosim.frames import Array, IntArray
from cosim.recording.colours import FLOOR_SHADE

FLOOR_NAME: Final = "floor"
_SHARP: Final = float(np.cos(np.radians(35.0)))


def rigid_mesh(shape: BodyShape, body: str) -> rr.Mesh3D:
    """Return a mesh with normals, smooth over curved faces and sharp at edges.

    Args:
        shape: what is drawn.
        body: its body's name; the floor is darkened, so that it stays behind what stands on it.
    """
    corners = shape.vertices[shape.triangles].reshape(-1, 3)
    shade = (*FLOOR_SHADE, 1.0) if body == FLOOR_NAME else (1.0, 1.0, 1.0, 1.0)
    return rr.Mesh3D(
        vertex_positions=corners.astype(np.float32),
        vertex_normals=corner_normals(shape.vertices, shape.triangles).astype(np.float32),
        triangle_indices=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        albedo_factor=[round(255 * part * factor) for part, factor in zip(shape.rgba, shade, strict=True)],
    )


def corner_normals(vertices: Array, triangles: IntArray) -> Array:
    """Return a normal for each corner of each triangle.

    The area-weighted mean over those triangles at the corner's vertex that turn less than 35 degrees
    away from the corner's own.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3) node indices.

    Returns:
        (3 m, 3), unit length; zero for triangles without area.
    """
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    face = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-30)
    corners, m = triangles.ravel(), len(triangles)
    at_vertex = csr_array((np.ones(3 * m), (np.arange(3 * m), corners)), shape=(3 * m, len(vertices)))
    touching = csr_array((np.ones(3 * m), (corners, np.repeat(np.arange(m), 3))), shape=(len(vertices), m))
    corner, neighbour = (at_vertex @ touching).nonzero()
    near = np.einsum("pa,pa->p", face[corner // 3], face[neighbour]) > _SHARP
    chosen = csr_array((near.astype(np.float64), (corner, neighbour)), shape=(3 * m, m))
    normals = chosen @ area
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))
