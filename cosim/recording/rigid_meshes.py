"""Rigid bodies as lit meshes, with normals that are smooth over curved faces and sharp at edges."""

from collections import Counter
from typing import Final

import numpy as np
import rerun as rr

from cosim.base.frames import Array, IntArray, cross
from cosim.base.solid import BodyShape
from cosim.recording import colours
from cosim.telemetry.run_info import RunInfo

FLOOR_NAME: Final = "floor"
_SHARP: Final = float(np.cos(np.radians(35.0)))


def body_path(name: str) -> str:
    """Return the entity of a rigid body."""
    return f"/world/rigid/{rr.escape_entity_path_part(name)}"


def log_rigid_meshes(stream: rr.RecordingStream, stage: RunInfo) -> None:
    """Log the shapes of all bodies below their entities, which are moved."""
    count: Counter[int] = Counter()
    for shape in stage.shapes:
        name = stage.body_names[shape.body]
        stream.log(f"{body_path(name)}/{count[shape.body]}", rigid_mesh(shape, name), static=True)
        count[shape.body] += 1


def rigid_mesh(shape: BodyShape, body: str) -> rr.Mesh3D:
    """Return a mesh with normals, smooth over curved faces and sharp at edges.

    Args:
        shape: of a body.
        body: name of the body; the floor is darker than the objects on it.
    """
    corners = shape.vertices[shape.triangles].reshape(-1, 3)
    shade = (*colours.FLOOR_SHADE, 1.0) if body == FLOOR_NAME else (1.0, 1.0, 1.0, 1.0)
    return rr.Mesh3D(
        vertex_positions=corners.astype(np.float32),
        vertex_normals=corner_normals(shape.vertices, shape.triangles).astype(np.float32),
        triangle_indices=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        albedo_factor=[round(255 * part * factor) for part, factor in zip(shape.rgba, shade, strict=True)],
    )


def corner_normals(vertices: Array, triangles: IntArray) -> Array:
    """Return a normal for each corner of each triangle.

    It is the area-weighted mean over the triangles at the corner's vertex whose normals differ less than 35
    degrees from that of the corner's triangle.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3) node indices.

    Returns:
        (3 m, 3), unit length; zero for triangles without area.
    """
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = np.ascontiguousarray(cross(b - a, c - a).T)
    face = area / np.maximum(np.sqrt((area * area).sum(axis=0)), 1e-30)
    corner, neighbour = _corners_that_meet(triangles.ravel())
    one, other = corner // 3, neighbour // 3
    near = sum(axis[one] * axis[other] for axis in face) > _SHARP
    corner, other = corner[near], other[near]
    normals = np.stack([np.bincount(corner, axis[other], 3 * len(triangles)) for axis in area])
    return np.asarray((normals / np.maximum(np.sqrt((normals * normals).sum(axis=0)), 1e-30)).T)


def _corners_that_meet(vertex: IntArray) -> tuple[IntArray, IntArray]:
    """Return all pairs of corners at one vertex, including pairs of a corner with itself: two arrays."""
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex)
    first = np.cumsum(count) - count  # of each vertex in `order`
    many = count[vertex[order]]
    index = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many - first[vertex[order]], many)
    return np.repeat(order, many), order[index]
