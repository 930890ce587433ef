"""Shapes of an arm's links from a compiled MuJoCo model, and back into a specification."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from cosim.base.arm_file import LinkShape
from cosim.base.frames import Pose
from cosim.rigid.build.description import VISUAL_GROUP

_KINDS: Final = {
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}
_HIDDEN_GROUP: Final = 3


def link_shapes(model: mujoco.MjModel, bodies: list[int], names: list[str]) -> tuple[LinkShape, ...]:
    """Return the shapes of bodies, in the frames of their links.

    What does not collide is drawn; a body that has nothing but what collides, is drawn by that. Planes and
    height fields belong to no link and are left out.

    Args:
        model: compiled.
        bodies: from the base to the flange.
        names: of their links.
    """
    shapes = []
    for body, name in zip(bodies, names, strict=True):
        first = int(model.body_jntadr[body])
        anchor = np.zeros(3) if first < 0 else model.jnt_pos[first]
        geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
        touched = {geom: bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) for geom in geoms}
        for geom, collides in touched.items():
            kind = _KINDS.get(mujoco.mjtGeom(model.geom_type[geom]))
            if kind is None:
                continue
            pose = Pose.from_quaternion(model.geom_quat[geom], model.geom_pos[geom] - anchor)
            drawn = not collides or all(touched.values())
            shapes.append(_shape(model, geom, name, kind, pose, collides=collides, drawn=drawn))
    return tuple(shapes)


def add_shapes(spec: mujoco.MjSpec, shapes: tuple[LinkShape, ...]) -> None:
    """Add shapes to the bodies of their links; they have no mass."""
    kinds = {kind: geom for geom, kind in _KINDS.items()}
    for number, shape in enumerate(shapes):
        geom = spec.body(shape.link).add_geom(type=kinds[shape.kind], rgba=shape.rgba, density=0.0)
        geom.pos, geom.quat = shape.pose.translation, shape.pose.quaternion
        geom.group = VISUAL_GROUP if shape.drawn else _HIDDEN_GROUP
        geom.contype = geom.conaffinity = int(shape.collides)
        if shape.kind == "mesh":
            mesh = spec.add_mesh(name=f"arm/{number}")
            mesh.uservert, mesh.userface = shape.vertices.ravel().tolist(), shape.triangles.ravel().tolist()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # also of one that is flat or open
            geom.meshname = mesh.name
        else:
            geom.size = shape.size


def _shape(
    model: mujoco.MjModel, geom: int, link: str, kind: str, pose: Pose, *, collides: bool, drawn: bool
) -> LinkShape:
    material = int(model.geom_matid[geom])
    colour = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    vertices, triangles = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    if kind == "mesh":
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        vertices = model.mesh_vert[first : first + count].astype(np.float64)
        triangles = model.mesh_face[start : start + faces].astype(np.int64)
    return LinkShape(
        link, kind, model.geom_size[geom].copy(), pose, colour.astype(np.float64),
        collides, drawn, vertices, triangles,
    )  # fmt: skip
