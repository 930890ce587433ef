"""Adds wires to a MuJoCo specification: capsules in a row, joined by ball joints. Between segments of length
l acts the moment -(EI / l) angle - (damping / l) angular velocity, so many segments bend like a beam of
flexural rigidity EI, and twist likewise.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from cosim.base.frames import Array, Pose, quaternion_from_rotation, rotation_from_vector
from cosim.config.schema.objects import WireTable
from cosim.rigid.build.description import VISUAL_GROUP, SceneObject
from cosim.rigid.build.object_bodies import HARD, world_pose

# A wire touches robots (bit 1) and objects (bit 2), but no wires.
_CONTACT = (4, 3)


def add_wire(spec: mujoco.MjSpec, wire: WireTable, objects: dict[str, SceneObject], tick_s: float) -> None:
    """Add the bodies of a wire, each a child of the one before, from its first point on.

    Args:
        spec: with the objects.
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
            # each joint has the length of the two half segments next to it; at a clamped end of one
            bent_m = 0.5 * length if k == 0 else 0.5 * (lengths[k - 1] + length)
            stiffness = wire.bending_stiffness_Nm2 / bent_m
            joint.stiffness = [stiffness, 0.0, 0.0]
            joint.damping = [wire.bending_damping_Nm2s / bent_m + stiffness * tick_s, 0.0, 0.0]
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
    """Set the stress-free shape of a wire to a straight line, if its table asks for it."""
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
    # MuJoCo scales a constraint's softness with the small inertia of the segment across the wire
    tie.solimp = HARD
    spec.add_exclude(bodyname1=item.name, bodyname2=name)


def _name(wire: WireTable, k: int) -> str:
    return f"{wire.name}/{k + 1}"


def wire_poses(wire: WireTable) -> Sequence[Pose]:
    """Return the pose of each segment, world from segment: origin at its first end, z along it, least twist.

    Args:
        wire: with points in the world.
    """
    knots = wire.knots
    axis, rotation, poses = np.array([0.0, 0.0, 1.0]), np.eye(3), []
    for k, length in enumerate(wire.lengths_m):
        ahead = (knots[k + 1] - knots[k]) / length
        rotation = rotation_from_vector(_turn(axis, ahead)) @ rotation
        axis = ahead
        poses.append(Pose(rotation, knots[k]))
    return tuple(poses)


def _turn(a: Array, b: Array) -> Array:
    """Return the shortest rotation vector (3,) [rad] that turns unit vector a to b."""
    normal = np.cross(a, b)
    sine = float(np.linalg.norm(normal))
    angle = float(np.arctan2(sine, a @ b))
    if sine > 1e-12:
        return np.asarray(normal * (angle / sine))
    aside = np.eye(3)[int(np.argmin(np.abs(a)))]
    across = np.cross(a, aside)
    return np.asarray(across * (angle / np.linalg.norm(across)))
