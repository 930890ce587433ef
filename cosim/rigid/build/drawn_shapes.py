"""Reads what is drawn of a MuJoCo model's bodies as plain triangle meshes."""

from __future__ import annotations

import mujoco
import numpy as np

from cosim.base.frames import Pose
from cosim.base.shown import BodyShape
from cosim.rigid.build import tessellation
from cosim.rigid.build.description import VISUAL_GROUP

_TILE_M = 0.25
_DARKER = 0.90


def body_shapes(model: mujoco.MjModel) -> tuple[BodyShape, ...]:
    """Return a mesh for each drawn geom, two for a plane (a checkerboard)."""
    shapes = []
    for geom in np.flatnonzero(model.geom_group == VISUAL_GROUP):
        body_from_geom = Pose.from_quaternion(model.geom_quat[geom], model.geom_pos[geom])
        material = int(model.geom_matid[geom])
        colour = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        red, green, blue, alpha = (float(c) for c in colour)
        for shade, (vertices, triangles) in zip((1.0, _DARKER), _meshes(model, int(geom)), strict=False):
            shapes.append(
                BodyShape(
                    int(model.geom_bodyid[geom]),
                    body_from_geom.apply(vertices),
                    np.asarray(triangles, dtype=np.int64),
                    (shade * red, shade * green, shade * blue, alpha),
                )
            )
    return tuple(shapes)


def _meshes(model: mujoco.MjModel, geom: int) -> tuple[tessellation.Mesh, ...]:
    size, kind = model.geom_size[geom], mujoco.mjtGeom(model.geom_type[geom])
    match kind:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return (tessellation.box(size),)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return (tessellation.sphere(size[0]),)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return (tessellation.ellipsoid(size),)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return (tessellation.cylinder(size[0], size[1]),)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return (tessellation.capsule(size[0], size[1]),)
        case mujoco.mjtGeom.mjGEOM_PLANE:
            return tessellation.checkerboard(size[:2], _TILE_M)
        case mujoco.mjtGeom.mjGEOM_HFIELD:
            field = int(model.geom_dataid[geom])
            first, rows, columns = model.hfield_adr[field], model.hfield_nrow[field], model.hfield_ncol[field]
            heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns)
            return (tessellation.height_field(model.hfield_size[field], heights),)
        case mujoco.mjtGeom.mjGEOM_MESH | mujoco.mjtGeom.mjGEOM_SDF:
            return (_mesh(model, int(model.geom_dataid[geom])),)
        case _:
            raise ValueError(f"geom {geom}: no way to draw {kind.name}")


def _mesh(model: mujoco.MjModel, mesh: int) -> tessellation.Mesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    # Every triangle gets its own corners, so that the edges of the casting stay sharp when shaded.
    corners = vertices[model.mesh_face[start : start + faces].reshape(-1)]
    return corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
