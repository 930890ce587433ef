"""Puts objects and wires into a MuJoCo specification, with contacts at their corners.

Puts objects into a MuJoCo specification: one body each, one geom for every convex solid of it.

Puts wires into a MuJoCo specification, and their stress-free shape into the compiled model.

Contacts of an object with what the flange carries, at the object's corners in every tick.

Of two solids MuJoCo keeps four points at most, not the same ones in every tick, and not the deepest ones: an
object that rests on a palm with five corners loses one of them, and with it newtons, every few ticks, and
walks. So its corners are points that touch the palm for themselves, besides what MuJoCo finds.
"""

from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose, quaternion_from_rotation
from cosim.base.solid import TriangleMesh
from cosim.config.schema.objects import WireTable
from cosim.rigid.build.description import VISUAL_GROUP, Geometry, Joint, PairFriction, SceneObject, wire_poses

OBJECT_CONTACT = (2, 3)  # floor and objects meet everything
SHAPES: Final = ("box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh")
GEOM_TYPES: Final = {name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}") for name in (*SHAPES, "plane")}
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


def mesh_of(model: mujoco.MjModel, geom: int) -> tuple[Array, IntArray]:
    """Return vertices (n, 3) [m] and triangles (m, 3) of a geom's mesh, geom frame."""
    mesh = int(model.geom_dataid[geom])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    vertices = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    return vertices, np.array(model.mesh_face[start : start + faces], dtype=np.int64)


def world_pose(item: SceneObject) -> Pose:
    """Return world from object, where the scene is drawn."""
    quaternion = np.array(item.quaternion, dtype=np.float64)
    return Pose.from_quaternion(quaternion, np.array(item.position_m))


# MuJoCo's contacts are the softer, the lighter a body is: by default 0.5 N press a ball of 1 g by 10 mm into
# a table, which throws it as it gets loose. So those of bodies below this mass are no softer than its own.
_LIGHT_KG = 1.0 / 60.0
_SOFTNESS_PER_KG, _LEAST_SOFTNESS = 3.0, 1e-4
# A palm bears what the film presses on it, whatever that weighs: by default 12 N press a spool of 20 g by
# 5 mm into it, and that far in, friction lets it tilt for seconds. If it was as hard where a body just
# touches, points would lie less deep than a step of a turning palm moves them: they would come off, and the
# body hop.
_MOUNTED_SOFTNESS: Final = 0.05, 1e-3
_HARD_M: Final = 1e-4  # from the first at the surface to the second at this depth
_DECIDES = 1e6  # share of a geom in the contact's parameters, over that of others


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
    spec: mujoco.MjSpec, carrier: mujoco.MjsBody, item: SceneObject, contact: tuple[int, int], tick_s: float
) -> None:
    """Add a body that is fixed to another one, posed in its frame, with the carrier's contact bits."""
    body = carrier.add_body(name=item.name, pos=item.position_m, quat=item.quaternion)
    add_geometries(spec, body, item)
    for geom in body.geoms:
        geom.contype, geom.conaffinity = contact
        # MuJoCo's step takes a tick off the time in which speeds become equal, and allows no less than two
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
    """Add the geoms of an object to its body, and share its mass among them."""
    solids = [(solid, mesh) for solid in item.geometries for mesh in _convex_meshes(solid)]
    weight = [s.relative_density * (s.volume_m3 if m is None else m.volume_m3) for s, m in solids]
    for k, (solid, mesh) in enumerate(solids):
        name = item.name if k == 0 else f"{item.name}/{k + 1}"
        geom = body.add_geom(name=name, type=GEOM_TYPES[solid.shape], pos=solid.position_m)
        geom.quat, geom.rgba = solid.quaternion, solid.rgba
        if 0.0 < item.mass_kg < _LIGHT_KG:
            share = max(_SOFTNESS_PER_KG * item.mass_kg, _LEAST_SOFTNESS)
            geom.solimp[:2], geom.solmix = 1.0 - share, _DECIDES
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


# It meets robots (bit 1) and objects (bit 2); two of its kind meet neither's bits.
_CONTACT = (4, 3)


def add_wire(spec: mujoco.MjSpec, wire: WireTable, objects: dict[str, SceneObject], tick_s: float) -> None:
    """Add the bodies of a wire, one inside the other from its first point on.

    Args:
        spec: holds the objects already.
        wire: to add.
        objects: of the scene by name.
        tick_s: length of a step [s], for the springs, see `Joint`.
    """
    parent = spec.worldbody if wire.first is None else spec.body(wire.first)
    outer = Pose() if wire.first is None else world_pose(objects[wire.first])
    lengths = wire.lengths_m
    for k, (pose, length) in enumerate(zip(wire_poses(wire), lengths, strict=True)):
        placed = outer.inverse() @ pose
        body = parent.add_body(name=_name(wire, k), pos=placed.translation, quat=placed.quaternion)
        body.simple = 0
        if k == 0 and wire.first is None:
            body.add_freejoint()
        else:
            joint = body.add_joint(name=_name(wire, k), type=mujoco.mjtJoint.mjJNT_BALL)
            # each joint stands for the half segments beside it, that at a clamped end for one
            share = 0.5 * length if k == 0 else 0.5 * (lengths[k - 1] + length)
            stiffness = wire.bending_stiffness_Nm2 / share
            joint.stiffness = [stiffness, 0.0, 0.0]
            joint.damping = [wire.bending_damping_Nm2s / share + stiffness * tick_s, 0.0, 0.0]
        geom = body.add_geom(name=_name(wire, k), type=mujoco.mjtGeom.mjGEOM_CAPSULE)
        geom.pos, geom.size = [0.0, 0.0, 0.5 * length], [wire.radius_m, 0.5 * length, 0.0]
        geom.mass = wire.mass_kg * length / lengths.sum()
        geom.rgba, geom.group = wire.rgba, VISUAL_GROUP
        geom.contype, geom.conaffinity = _CONTACT
        geom.friction = [wire.friction, 0.005, 0.0001]
        parent, outer = body, pose
    if wire.first is not None:
        spec.add_exclude(bodyname1=wire.first, bodyname2=_name(wire, 0))
    if wire.last is not None:
        _tie(spec, wire, objects[wire.last])


def relax_wire(model: mujoco.MjModel, wire: WireTable) -> None:
    """Make a wire stress-free where it is straight, if it says so; otherwise it is so where it is drawn."""
    if not wire.straight:
        return
    poses = wire_poses(wire)
    for k in range(1, wire.segments):
        place = int(model.joint(_name(wire, k)).qposadr[0])
        bent = poses[k - 1].rotation.T @ poses[k].rotation
        model.qpos_spring[place : place + 4] = quaternion_from_rotation(bent.T)


def _tie(spec: mujoco.MjSpec, wire: WireTable, item: SceneObject) -> None:
    final, name = wire.knots[-1], _name(wire, wire.segments - 1)
    tie = spec.add_equality(name=f"{wire.name}/last", type=mujoco.mjtEq.mjEQ_CONNECT)
    tie.objtype, tie.name1, tie.name2 = mujoco.mjtObj.mjOBJ_BODY, name, item.name
    tie.data[:3] = wire_poses(wire)[-1].inverse().apply(final[None])[0]
    # MuJoCo scales a constraint's softness with what the light segment weighs across the wire
    tie.solimp = HARD
    spec.add_exclude(bodyname1=item.name, bodyname2=name)


def _name(wire: WireTable, k: int) -> str:
    return f"{wire.name}/{k + 1}"


_POINT_M: Final = 1e-6  # MuJoCo knows no points: radius of a sphere
_AROUND: Final = 12  # of a cylinder's rim: between two of them it stands out by 3.4 % of its radius
_DIRECTIONS: Final = 256  # in which corners of a mesh are looked for
_GOLDEN: Final = np.pi * (3.0 - np.sqrt(5.0))


def add_corner_contacts(
    spec: mujoco.MjSpec, carried: Sequence[mujoco.MjsBody], touching: mujoco.MjsBody, friction: PairFriction
) -> None:
    """Let the corners of a body touch other ones, as the others' geoms are touched.

    Args:
        spec: holds both.
        carried: on flanges; their geoms have names, and priority over those of objects.
        touching: an object that can move; its geoms have names.
        friction: of pairs.
    """
    for geom in list(touching.geoms):
        body_from_geom = Pose.from_quaternion(np.array(geom.quat), np.array(geom.pos))
        for k, place in enumerate(body_from_geom.apply(_corners(spec, geom))):
            name = f"{geom.name}/corner {k + 1}"
            # contact bits of 0: nothing but what is named in a pair meets it
            corner = touching.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, contype=0, conaffinity=0)
            corner.size, corner.pos, corner.mass = [_POINT_M, 0.0, 0.0], place, 0.0
            for body in carried:
                for other in body.geoms:
                    both = other.friction[0], geom.friction[0]
                    _add_pair(spec, other, name, friction.between((body.name, touching.name), both))


def _add_pair(spec: mujoco.MjSpec, carried: mujoco.MjsGeom, corner: str, sliding: float) -> None:
    """Let a corner touch a geom; the contact is as the geom has it, but for the coefficient of sliding."""
    pair = spec.add_pair(geomname1=carried.name, geomname2=corner)
    _, turning, rolling = carried.friction
    pair.friction = [sliding, sliding, turning, rolling, rolling]
    pair.condim, pair.solref, pair.solimp = carried.condim, carried.solref, carried.solimp


def _corners(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> Array:
    """Return corners (n, 3) [m] of a geom in its own frame; none of what is round all over."""
    match geom.type:
        case mujoco.mjtGeom.mjGEOM_BOX:
            signs = 2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0
            return np.asarray(signs * geom.size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            angle = np.arange(_AROUND) * 2.0 * np.pi / _AROUND
            radius, half = geom.size[:2]
            rim = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(_AROUND, half)))
            return np.concatenate((rim, rim * (1.0, 1.0, -1.0)))
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _fewer(np.array(spec.mesh(geom.meshname).uservert).reshape(-1, 3))
        case _:
            return np.zeros((0, 3))


def _fewer(vertices: Array) -> Array:
    """Return some of vertices (n, 3) [m], over whose hull the others stand out no more than a cylinder's."""
    corners = vertices[np.unique([np.argmax(vertices @ way) for way in _directions(_DIRECTIONS)])]
    centred, reach = corners - corners.mean(axis=0), corners @ _directions(4 * _DIRECTIONS).T
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    across = np.ptp(centred @ axes.T, axis=0)
    least = reach.max(axis=0) - 0.5 * np.median(across) * (1.0 - np.cos(np.pi / _AROUND))
    kept = np.ones(len(corners), dtype=bool)
    for k in range(len(corners)):
        kept[k] = False
        kept[k] = not kept.any() or (reach[kept].max(axis=0) < least).any()
    return np.asarray(corners[kept])


def _directions(count: int) -> Array:
    """Return directions (count, 3) that are spread evenly, on a spiral of golden angles."""
    place = np.arange(count)
    height = 1.0 - (2.0 * place + 1.0) / count
    across = np.sqrt(1.0 - height**2)
    return np.column_stack((across * np.cos(_GOLDEN * place), across * np.sin(_GOLDEN * place), height))
