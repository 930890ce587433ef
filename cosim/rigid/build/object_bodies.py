"""Adds objects to a MuJoCo specification: one body for each object, one geom for each of its convex
solids.
"""

from typing import Final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.triangle_mesh import TriangleMesh
from cosim.rigid.build.description import VISUAL_GROUP, Geometry, Joint, SceneObject

OBJECT_CONTACT = (2, 3)  # floor and objects meet everything
SHAPES: Final = ("box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh")
GEOM_TYPES: Final = {name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}") for name in (*SHAPES, "plane")}
_ROUND = ("sphere", "cylinder", "capsule")  # given by their radius, not by their diameter
HARD = [0.9999, 0.9999, 0.001, 0.5, 2.0]  # solimp of an almost rigid constraint; impedance 1 would be rigid
_SPIN_FRICTION_M = (0.005, 0.0001)  # MuJoCo's defaults, which contacts of three dimensions do not use
_SPIN_CONTACT = 6  # dimensions of a contact with friction against sliding, turning and rolling
_HOLLOW = 1.0  # user value of a geom whose surface, not its hull, soft robots touch
# MuJoCo's contacts are softer for lighter bodies: by default 0.5 N press a ball of 1 g by 10 mm into a table,
# which throws it when it is released. So lighter bodies than this have the contact stiffness of this mass.
_LIGHT_KG = 1.0 / 60.0
_SOFTNESS_PER_KG, _LEAST_SOFTNESS = 3.0, 1e-4
# The film presses even light bodies on a palm: by default 12 N press a spool of 20 g by 5 mm into it, and at
# that depth friction lets it tilt for seconds. With the same stiffness at the surface, contact points would
# be less deep than the distance that a turning palm moves them in a step: they would separate, and the body
# would hop.
_MOUNTED_SOFTNESS: Final = 0.05, 1e-3
_HARD_M: Final = 1e-4  # depth over which the softness changes from the first value to the second
_DECIDES = 1e6  # solmix of a geom whose parameters decide


def prepare(spec: mujoco.MjSpec) -> None:
    """Reserve one user value per geom, for `hollow`."""
    spec.nuser_geom = 1


def hollow(model: mujoco.MjModel) -> Array:
    """Return a mask (g,) of geoms that soft robots touch by a table of distances, not by the convex hull."""
    if not model.nuser_geom:
        return np.zeros(model.ngeom, dtype=bool)
    return np.asarray(model.geom_user[:, 0] == _HOLLOW)


def mesh_of(model: mujoco.MjModel, geom: int) -> tuple[Array, IntArray]:
    """Return vertices (n, 3) [m] and triangles (m, 3) of a geom's mesh, geom frame."""
    mesh = int(model.geom_dataid[geom])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    vertices = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    return vertices, np.array(model.mesh_face[start : start + faces], dtype=np.int64)


def world_pose(item: SceneObject) -> Pose:
    """Return the pose of an object at the start, world from object."""
    quaternion = np.array(item.quaternion, dtype=np.float64)
    return Pose.from_quaternion(quaternion, np.array(item.position_m))


def add_object(
    spec: mujoco.MjSpec, item: SceneObject, objects: dict[str, SceneObject], tick_s: float
) -> None:
    """Add an object's body to its parent.

    Args:
        spec: with the object's parent.
        item: the object.
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
    spec: mujoco.MjSpec, carrier: mujoco.MjsBody, item: SceneObject, contact: tuple[int, int], tick_s: float
) -> None:
    """Add a body that is fixed to another one.

    Args:
        spec: with the carrier.
        carrier: the body that it is fixed to.
        item: with its pose in the carrier's frame.
        contact: contype and conaffinity of its geoms.
        tick_s: length of a step [s].
    """
    body = carrier.add_body(name=item.name, pos=item.position_m, quat=item.quaternion)
    add_geometries(spec, body, item)
    for geom in body.geoms:
        geom.contype, geom.conaffinity = contact
        # the effective time constant is one step shorter, and MuJoCo allows no less than two steps
        geom.priority, geom.solref = 1, [max(item.contact_time_s, tick_s) + tick_s, 1.0]
        geom.solimp[:3] = *(1.0 - np.array(_MOUNTED_SOFTNESS)), _HARD_M


def _add_joint(body: mujoco.MjsBody, item: SceneObject, joint: Joint, tick_s: float) -> None:
    kinds = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
    own = body.add_joint(name=item.name, type=kinds[joint.kind])
    object_from_world = world_pose(item).inverse()
    own.axis = object_from_world.rotation @ np.array(joint.axis)
    own.pos = object_from_world.apply(np.array([joint.anchor_m]))[0]
    own.frictionloss, own.solimp_friction = joint.friction, HARD
    # linear, quadratic, cubic
    own.stiffness = [joint.stiffness, 0.0, 0.0]
    own.damping = [joint.damping, 0.0, 0.0]
    own.armature = 0.25 * joint.stiffness * tick_s**2  # see `Joint`
    own.limited = joint.limits is not None
    if joint.limits is not None:
        own.range = joint.limits


def add_geometries(spec: mujoco.MjSpec, body: mujoco.MjsBody, item: SceneObject) -> None:
    """Add the geoms of an object to its body, and divide its mass among them."""
    solids = [(solid, mesh) for solid in item.geometries for mesh in _convex_meshes(solid)]
    weight = [s.relative_density * (s.volume_m3 if m is None else m.volume_m3) for s, m in solids]
    for k, (solid, mesh) in enumerate(solids):
        name = item.name if k == 0 else f"{item.name}/{k + 1}"
        geom = body.add_geom(name=name, type=GEOM_TYPES[solid.shape], pos=solid.position_m)
        geom.quat, geom.rgba = solid.quaternion, solid.rgba
        if 0.0 < item.mass_kg < _LIGHT_KG:
            softness = max(_SOFTNESS_PER_KG * item.mass_kg, _LEAST_SOFTNESS)
            geom.solimp[:2], geom.solmix = 1.0 - softness, _DECIDES
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
