"""Compiles a scene description into a MuJoCo model."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from bisect import bisect_left
from dataclasses import replace
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

from cosim.base.frames import Pose
from cosim.config.arms.link_shapes import readable_mesh
from cosim.errors import InputError, SceneError
from cosim.rigid.build.cell_reading import attach_cell
from cosim.rigid.build.corner_contacts import add_corner_contacts
from cosim.rigid.build.description import (
    FLANGE_SITE,
    FORCE_SENSOR,
    TORQUE_SENSOR,
    SceneDescription,
    SceneObject,
    ServoGains,
)
from cosim.rigid.build.mjcf_shapes import add_shapes
from cosim.rigid.build.model_numbers import check_finite
from cosim.rigid.build.object_bodies import add_mounted, add_object, prepare
from cosim.rigid.build.wire_bodies import add_wire, relax_wire

FLANGE_MOUNT = "flange_mount"
FLOOR = "floor"

# Robot links meet floor and objects but not one another.
_ROBOT_CONTACT = (1, 2)
_FRICTION_OVER_NORMAL = 1e4  # impedances of a contact: below friction's limit, creep goes with its inverse
_TOLERANCE = 1e-14  # of contact forces, relative to a mean inertia that is the arm's more than the objects'
_DEPTH_TOLERANCE_M = 1e-9  # normals of shapes that touch less deeply may point the other way
_MESH_GREY = "0.80 0.81 0.83 1"
_FLOOR_GREY = (0.86, 0.87, 0.88, 1.0)


def compile_model(description: SceneDescription) -> mujoco.MjModel:
    """Return the MuJoCo model of a scene.

    Raises:
        InputError: MuJoCo cannot read the arm's file.
        SceneError: MuJoCo refuses an object or a wire.
    """
    try:
        return _compiled(description)
    except ValueError as error:
        raise SceneError(f"MuJoCo refuses it: {error}".replace("\n", ", "), _refused(description)) from None


def _refused(description: SceneDescription) -> str | None:
    """Return the first body without which, and without all after it, MuJoCo accepts a scene."""
    objects, wires = description.objects_by_parent(), description.wires
    names = [item.name for item in objects] + [wire.name for wire in wires]

    def accepted(count: int) -> bool:
        fewer = replace(description, objects=objects[:count], wires=wires[: max(0, count - len(objects))])
        try:
            _compiled(fewer)
        except ValueError:
            return False
        return True

    count = bisect_left(range(len(names) + 1), True, key=lambda k: not accepted(k))
    return names[count - 1] if 0 < count <= len(names) else None


def _compiled(description: SceneDescription) -> mujoco.MjModel:
    arm = description.arm
    try:
        spec = mujoco.MjSpec.from_string(_mujoco_urdf(arm.urdf))
    except ValueError as error:
        text = str(error).replace("\n", ", ")
        raise InputError(f"arm {arm.name!r}: MuJoCo cannot read {arm.path}: {text}") from None
    spec.compiler.degree = False
    spec.option.timestep = description.tick_s
    spec.option.gravity = description.gravity
    spec.option.tolerance, spec.option.ccd_tolerance = _TOLERANCE, _DEPTH_TOLERANCE_M
    # servos are implicit by their share of the mass matrix, see `RigidScene`, and joint damping is by itself
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    _place_base(spec, description.world_from_base or arm.world_from_base)
    _prepare_arm(spec, description)
    cell = description.cell
    if description.floor_height_m is not None and not (cell is not None and cell.has_plane):
        height = description.floor_height_m
        floor = SceneObject(FLOOR, "plane", (4.0, 4.0), (0.0, 0.0, height), rgba=_FLOOR_GREY)
        add_object(spec, floor, {}, description.tick_s)
    prepare(spec)
    if description.mounted:
        # What a palm clamps must not creep, as MuJoCo's regularised friction does. With its default, a
        # pyramid for a cone, it would all the same: each of the pyramid's two directions has a share of
        # the normal force for itself.
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = _FRICTION_OVER_NORMAL
    for item in description.mounted:
        add_mounted(spec, spec.body(FLANGE_MOUNT), item, _ROBOT_CONTACT, description.tick_s)
    objects = {item.name: item for item in description.objects}
    for item in description.objects_by_parent():
        add_object(spec, item, objects, description.tick_s)
    for carried, item in product(description.mounted, description.objects):
        if item.mass_kg > 0.0:
            add_corner_contacts(spec, spec.body(carried.name), spec.body(item.name))
    for wire in description.wires:
        add_wire(spec, wire, objects, description.tick_s)
    if cell is not None:
        still = [item.name for item in description.objects if item.mass_kg == 0.0]
        ground = [FLOOR] if spec.body(FLOOR) is not None else []
        attach_cell(spec, cell, [*still, *ground])
    model = spec.compile()
    for wire in description.wires:
        relax_wire(model, wire)
    check_finite(model)
    return model


def _mujoco_urdf(urdf: str) -> str:
    """Return the URDF with MuJoCo's reading options and only meshes that MuJoCo can decode."""
    robot = ElementTree.fromstring(urdf)
    for link in robot.findall("link"):
        files = [mesh.get("filename", "") for shape in link.findall("visual") for mesh in shape.iter("mesh")]
        if all(readable_mesh(Path(file)) for file in files):
            continue
        for shape in link.findall("visual"):
            link.remove(shape)
        for shape in link.findall("collision"):
            drawn = copy.deepcopy(shape)
            drawn.tag = "visual"
            material = ElementTree.SubElement(drawn, "material", name="link")
            ElementTree.SubElement(material, "color", rgba=_MESH_GREY)
            link.append(drawn)
    options = {"discardvisual": "false", "fusestatic": "false", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", options)
    return ElementTree.tostring(robot, encoding="unicode")


def _place_base(spec: mujoco.MjSpec, world_from_base: Pose) -> None:
    for body in spec.worldbody.bodies:
        placed = world_from_base @ Pose.from_quaternion(np.array(body.quat), np.array(body.pos))
        body.pos, body.quat = placed.translation, placed.quaternion


def _prepare_arm(spec: mujoco.MjSpec, description: SceneDescription) -> None:
    """Give the arm its rotor inertia, servos, contact filter, flange site and sensors."""
    arm = description.arm
    joints = [spec.joint(name) for name in arm.joint_names]
    gains = description.gains or ServoGains.of(arm, np.array([joint.actfrcrange[1] for joint in joints]))
    rotors = arm.armature if description.armature is None else np.full(len(joints), description.armature)
    inputs = mujoco.mjtCtrlInput
    all_inputs = int(inputs.mjINPUT_POS) | int(inputs.mjINPUT_VEL) | int(inputs.mjINPUT_FF)
    for joint, rotor, stiffness, damping in zip(joints, rotors, gains.stiffness, gains.damping, strict=True):
        joint.armature = rotor
        servo = spec.add_actuator(
            name=f"{joint.name}_servo", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_pid(kp=stiffness, kv=damping, ctrlspec=all_inputs)
    add_shapes(spec, arm.shapes)
    for geom in spec.geoms:
        geom.density = 0.0  # a link without <inertial> has no mass, whatever its shapes
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _ROBOT_CONTACT
    # A massless body of its own: loads act at its origin, and the sensor above it sees them alone.
    mount = spec.body(arm.flange_frame).add_body(name=FLANGE_MOUNT)
    mount.add_site(name=FLANGE_SITE)
    for name, kind in (
        (FORCE_SENSOR, mujoco.mjtSensor.mjSENS_FORCE),
        (TORQUE_SENSOR, mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=FLANGE_SITE)
