"""Puts objects into a MuJoCo specification: one body each, one geom for every convex solid of it."""

from __future__ import annotations

import mujoco
import numpy as np

from cosim.base.frames import Array, Pose
from cosim.base.triangle_mesh import TriangleMesh
from cosim.rigid.build.description import VISUAL_GROUP, SceneObject
from cosim.rigid.build.geometry import Geometry
from cosim.rigid.build.joint import Joint

OBJECT_CONTACT = (2, 3)  # floor and objects meet everything
_GEOM_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
    "plane": mujoco.mjtGeom.mjGEOM_PLANE,
}
_ROUND = ("sphere", "cylinder", "capsule")  # given by their radius, not by their diameter
HARD = [0.9999, 0.9999, 0.001, 0.5, 2.0]  # of a constraint that hardly gives way; 1 would be rigid
_SPIN_FRICTION_M = (0.005, 0.0001)  # MuJoCo's own, which contacts of three dimensions do not ask for
_SPIN_CONTACT = 6  # dimensions of a contact that withstands sliding, turning and rolling
_HOLLOW = 1.0  # user value of a geom whose surface, not its hull, soft robots touch


def prepare(spec: mujoco.MjSpec) -> None:
    """Make room for what objects tell about their geoms."""
    spec.nuser_geom = 1


def hollow(model: mujoco.MjModel) -> Array:
    """Return which geoms (g,) soft robots touch by a table of distances instead of the convex hull."""
    if not model.nuser_geom:
        return np.zeros(model.ngeom, dtype=bool)
    return np.asarray(model.geom_user[:, 0] == _HOLLOW)


def world_pose(item: SceneObject) -> Pose:
    """Return world from object, where the scene is drawn."""
    quaternion = np.array(item.quaternion, dtype=np.float64)
    return Pose.from_quaternion(quaternion, np.array(item.position_m))


def add_object(
    spec: mujoco.MjSpec, item: SceneObject, objects: dict[str, SceneObject], tick_s: float
) -> None:
    """Add an object's body to what it hangs on.

    Args:
        spec: holds the object's parent already.
        item: to add.
        objects: of the scene by name.
        tick_s: length of a step [s], for the springs, see `Joint`.
    """
    joint = item.joint
    if joint is None or joint.parent is None:
        parent, outer = spec.worldbody, Pose()
    else:
        parent, outer = spec.body(joint.parent), world_pose(objects[joint.parent])
        spec.add_exclude(bodyname1=joint.parent, bodyname2=item.name)
    placed = outer.inverse() @ world_pose(item)
    body = parent.add_body(name=item.name, pos=placed.translation, quat=placed.quaternion)
    if joint is not None:
        _add_joint(body, item, joint, tick_s)
    elif item.mass_kg > 0.0:
        body.add_freejoint()
    if item.mass_kg > 0.0:
        # Otherwise MuJoCo ignores later edits of the body's armature.
        body.simple = 0
    add_geometries(spec, body, item)
    if item.inertia is not None:
        body.explicitinertial, body.mass = True, item.mass_kg
        body.ipos, body.inertia = item.center_of_mass_m, item.inertia


def add_mounted(
    spec: mujoco.MjSpec,
    carrier: mujoco.MjsBody,
    item: SceneObject,
    contact: tuple[int, int],
    tick_s: float,
) -> None:
    """Add a body that is fixed to another one, posed in its frame, with the carrier's contact bits."""
    body = carrier.add_body(name=item.name, pos=item.position_m, quat=item.quaternion)
    add_geometries(spec, body, item)
    for geom in body.geoms:
        geom.contype, geom.conaffinity = contact
        # harder than this, contacts chatter: of a mesh four points are kept, not the same ones every tick
        geom.priority, geom.solref = 1, [4.0 * tick_s, 1.0]


def _add_joint(body: mujoco.MjsBody, item: SceneObject, joint: Joint, tick_s: float) -> None:
    kinds = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
    own = body.add_joint(name=item.name, type=kinds[joint.kind])
    object_from_world = world_pose(item).inverse()
    own.axis = object_from_world.rotation @ np.array(joint.axis)
    own.pos = object_from_world.apply(np.array([joint.anchor_m]))[0]
    own.frictionloss, own.solimp_friction = joint.friction, HARD
    # linear, quadratic, cubic
    own.stiffness = [joint.stiffness, 0.0, 0.0]
    own.damping = [joint.damping + joint.stiffness * tick_s, 0.0, 0.0]
    own.limited = joint.limits is not None
    if joint.limits is not None:
        own.range = joint.limits


def add_geometries(spec: mujoco.MjSpec, body: mujoco.MjsBody, item: SceneObject) -> None:
    """Add the geoms of an object to its body, and share its mass among them."""
    solids = [(solid, mesh) for solid in item.geometries for mesh in _convex_meshes(solid)]
    weight = [s.relative_density * (s.volume_m3 if m is None else m.volume_m3) for s, m in solids]
    for k, (solid, mesh) in enumerate(solids):
        name = item.name if k == 0 else f"{item.name}/{k + 1}"
        geom = body.add_geom(name=name, type=_GEOM_TYPES[solid.shape], pos=solid.position_m)
        geom.quat, geom.rgba = solid.quaternion, solid.rgba
        if mesh is None:
            geom.size = _mujoco_size(solid)
        else:
            geom.meshname = _add_mesh(spec, name, mesh)
            geom.userdata = [0.0 if solid.convex else _HOLLOW]
        geom.group = VISUAL_GROUP
        geom.contype, geom.conaffinity = OBJECT_CONTACT
        geom.friction = [solid.friction, *(item.spin_friction_m or _SPIN_FRICTION_M)]
        if item.spin_friction_m is not None:
            geom.condim = _SPIN_CONTACT
        if item.mass_kg > 0.0:
            geom.mass = item.mass_kg * weight[k] / sum(weight)


def _convex_meshes(solid: Geometry) -> tuple[TriangleMesh | None, ...]:
    if solid.mesh is None:
        return (None,)
    return solid.mesh.shells() if solid.convex else (solid.mesh,)


def _mujoco_size(solid: Geometry) -> Array:
    size = np.zeros(3)
    size[: len(solid.size_m)] = solid.size_m
    if solid.shape == "ellipsoid":
        return size
    halved = 0.5 * size
    if solid.shape in _ROUND:
        halved[0] = size[0]
    if solid.shape == "plane":
        halved[2] = 0.1
    return halved


def _add_mesh(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh) -> str:
    asset = spec.add_mesh(name=name)
    asset.uservert, asset.userface = mesh.vertices.ravel().tolist(), mesh.triangles.ravel().tolist()
    asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
    return name
