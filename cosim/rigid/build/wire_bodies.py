"""Puts wires into a MuJoCo specification, and their stress-free shape into the compiled model."""

from __future__ import annotations

import mujoco

from cosim.base.frames import Pose, quaternion_from_rotation
from cosim.rigid.build.description import VISUAL_GROUP, SceneObject
from cosim.rigid.build.object_bodies import HARD, world_pose
from cosim.rigid.build.wire import Wire

# It meets robots (bit 1) and objects (bit 2); two of its kind meet neither's bits.
_CONTACT = (4, 3)


def add_wire(spec: mujoco.MjSpec, wire: Wire, objects: dict[str, SceneObject], tick_s: float) -> None:
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
    for k, (pose, length) in enumerate(zip(wire.poses(), lengths, strict=True)):
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


def relax_wire(model: mujoco.MjModel, wire: Wire) -> None:
    """Make a wire stress-free where it is straight, if it says so; otherwise it is so where it is drawn."""
    if not wire.straight:
        return
    poses = wire.poses()
    for k in range(1, wire.segments):
        place = int(model.joint(_name(wire, k)).qposadr[0])
        bent = poses[k - 1].rotation.T @ poses[k].rotation
        model.qpos_spring[place : place + 4] = quaternion_from_rotation(bent.T)


def _tie(spec: mujoco.MjSpec, wire: Wire, item: SceneObject) -> None:
    final, name = wire.knots[-1], _name(wire, wire.segments - 1)
    tie = spec.add_equality(name=f"{wire.name}/last", type=mujoco.mjtEq.mjEQ_CONNECT)
    tie.objtype, tie.name1, tie.name2 = mujoco.mjtObj.mjOBJ_BODY, name, item.name
    tie.data[:3] = wire.poses()[-1].inverse().apply(final[None])[0]
    # MuJoCo scales a constraint's softness with what the light segment weighs across the wire
    tie.solimp = HARD
    spec.add_exclude(bodyname1=item.name, bodyname2=name)


def _name(wire: Wire, k: int) -> str:
    return f"{wire.name}/{k + 1}"
