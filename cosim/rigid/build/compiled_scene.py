"""Compiles a scene description into a MuJoCo model, from which any number of scenes can be made."""

import copy
import xml.etree.ElementTree as ElementTree
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.frames import Pose
from cosim.base.solid import BodyShape
from cosim.errors import SceneError
from cosim.rigid.build import corner_contacts, drawn_arm, engine, mjcf_arm, object_bodies, urdf_arm, wires
from cosim.rigid.build.cell import attach_cell
from cosim.rigid.build.description import SceneDescription, SceneObject, ServoGains
from cosim.rigid.build.drawn_shapes import body_shapes
from cosim.rigid.build.scene_names import (
    FLANGE_CONTACTS,
    FLANGE_SITE,
    FORCE_SENSOR,
    OBJECT_CONTACTS,
    TORQUE_SENSOR,
)

_STIFF_FRICTION: Final = 0.999  # impedance of joints with dry friction that stand still, below 1


FLANGE_MOUNT = "flange_mount"
FLOOR = "floor"

# Robot links meet floor and objects but not one another.
_ROBOT_CONTACT = (1, 2)
_OTHER_ARMS = 8  # bit of the first of several arms, which meet one another
_FRICTION_OVER_NORMAL = 1e4  # impedances of a contact: below friction's limit, creep goes with its inverse
_WITH_WIRES = 1e2  # the same with wires: stiffer friction at their many contacts doubles the cost of a step
_TOLERANCE = 1e-14  # of contact forces, relative to the mean inertia, which is mostly that of the arm
# Most points in the search along a Newton step; after them MuJoCo ends the iteration, whatever force
# remains. Its default of 50 is too small for friction at many points: a clamped spool shook the arm.
_SEARCHES_MAX = 500
# Tolerance of the slope along a Newton step, over `_TOLERANCE`. MuJoCo's default of 0.01 is below the
# rounding error, so searches did not end: a sixth of the time of a step.
_SEARCH_TOLERANCE = 100.0
_DEPTH_TOLERANCE_M = 1e-9  # normals of shapes that touch less deeply may point the other way
_FEW_TREES = 2  # such as a gripper and one object: finding islands costs more than solving all at once
_FLOOR_GREY = (0.86, 0.87, 0.88, 1.0)


def compile_model(description: SceneDescription, arms: tuple[SceneDescription, ...] = ()) -> mujoco.MjModel:
    """Return the MuJoCo model of a scene.

    Args:
        description: of the scene.
        arms: further arms in it; of their descriptions only the arm, its base and mounted bodies are used.

    Raises:
        InputError: MuJoCo cannot read the arm's file.
        SceneError: MuJoCo refuses an object or a wire.
    """
    try:
        return _compiled(description, arms)
    except ValueError as error:
        body = _refused(description, arms)
        paths = ", ".join(str(one.arm.path) for one in (description, *arms))
        what = f"a scene with {paths}" if body is None else "it"
        raise SceneError(f"MuJoCo refuses {what}: {error}".replace("\n", ", "), body) from None


def _refused(description: SceneDescription, arms: tuple[SceneDescription, ...]) -> str | None:
    """Return the name of the object or wire that MuJoCo refuses, by bisection; None if it is another part."""
    objects, wires = description.objects_by_parent(), description.wires
    names = [item.name for item in objects] + [wire.name for wire in wires]

    def accepted(count: int) -> bool:
        fewer = replace(description, objects=objects[:count], wires=wires[: max(0, count - len(objects))])
        try:
            _compiled(fewer, arms)
        except ValueError:
            return False
        return True

    count = bisect_left(range(len(names) + 1), True, key=lambda k: not accepted(k))
    return names[count - 1] if 0 < count <= len(names) else None


def _compiled(description: SceneDescription, arms: tuple[SceneDescription, ...] = ()) -> mujoco.MjModel:
    together = (description, *arms)
    spec = mujoco.MjSpec() if arms else _arm_spec(description)
    _set_options(spec, description)
    for place, one in enumerate(together if arms else ()):
        added = _arm_spec(one)
        _set_options(added, description)
        _meet_other_arms(added, place, len(together))
        spec.attach(added, prefix=one.prefix, frame=spec.worldbody.add_frame())
    mounted = [replace(item, name=one.prefix + item.name) for one in together for item in one.mounted]
    _add_surroundings(spec, description, mounted)
    names, wire_names = ([item.name for item in items] for items in (mounted, description.wires))
    description.friction.add_contacts(spec, names, wire_names)
    mounts = [one.prefix + FLANGE_MOUNT for one in together]
    for item in description.objects:
        if item.mass_kg > 0.0:
            _count_contacts(spec, item.name, mounts)
    model = spec.compile()
    if mounted and model.ntree <= _FEW_TREES:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    for wire in description.wires:
        wires.relax_wire(model, wire)
    engine.check_finite(model)
    return model


def _count_contacts(spec: mujoco.MjSpec, name: str, mounts: Sequence[str]) -> None:
    """Add sensors that count an object's contacts: with all rigid bodies, and with those on each flange."""
    for mount in ("", *mounts):
        sensor = _add_counter(spec, f"{OBJECT_CONTACTS} {name} {mount}", (mujoco.mjtObj.mjOBJ_BODY, name))
        if mount:
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_XBODY, mount


def _add_counter(spec: mujoco.MjSpec, name: str, of: tuple[mujoco.mjtObj, str]) -> mujoco.MjsSensor:
    """Add a sensor that counts the contacts of a body (mjOBJ_BODY) or of its subtree (mjOBJ_XBODY)."""
    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=of[0], objname=of[1])
    sensor.intprm[:3] = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1
    return sensor


def _arm_spec(description: SceneDescription) -> mujoco.MjSpec:
    """Return the specification of an arm at its base, with servos, sensors and bodies on its flange."""
    arm = description.arm
    spec = urdf_arm.urdf_spec(ElementTree.fromstring(arm.urdf), arm.path)
    _place_base(spec, description.world_from_base or arm.world_from_base)
    _prepare_arm(spec, description)
    for item in description.mounted:
        object_bodies.add_mounted(spec, spec.body(FLANGE_MOUNT), item, _ROBOT_CONTACT, description.step_s)
    return spec


def _meet_other_arms(spec: mujoco.MjSpec, place: int, count: int) -> None:
    """Enable contact of an arm's geoms with all other arms; each arm has a contact bit."""
    bits = [_OTHER_ARMS << k for k in range(count)]
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype |= bits[place]
            geom.conaffinity |= sum(bits) - bits[place]


def _set_options(spec: mujoco.MjSpec, description: SceneDescription) -> None:
    spec.compiler.degree = False
    spec.option.timestep = description.step_s
    spec.option.gravity = description.gravity
    spec.option.tolerance, spec.option.ls_iterations = _TOLERANCE, _SEARCHES_MAX
    spec.option.ls_tolerance = _SEARCH_TOLERANCE
    spec.option.ccd_tolerance = _DEPTH_TOLERANCE_M
    # servo damping is implicit through the armature, see `servos`; joint damping through MuJoCo's integrator
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # A body that friction holds must not creep, as it does with MuJoCo's regularised friction. With the
    # default pyramidal cone it would creep at any impratio: each of the pyramid's two directions has a part
    # of the normal force.
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = _WITH_WIRES if description.wires else _FRICTION_OVER_NORMAL
    object_bodies.prepare(spec)


def _add_surroundings(
    spec: mujoco.MjSpec, description: SceneDescription, mounted: Sequence[SceneObject]
) -> None:
    """Add floor, objects, wires and cell to a specification with arms."""
    cell = description.cell
    if description.floor_height_m is not None and not (cell is not None and cell.has_plane):
        height = description.floor_height_m
        floor = SceneObject(FLOOR, "plane", (4.0, 4.0), (0.0, 0.0, height), rgba=_FLOOR_GREY)
        object_bodies.add_object(spec, floor, {}, description.step_s)
    objects = {item.name: item for item in description.objects}
    for item in description.objects_by_parent():
        object_bodies.add_object(spec, item, objects, description.step_s)
    carried = [spec.body(item.name) for item in mounted]
    for item in description.objects:
        if carried and item.mass_kg > 0.0:
            corner_contacts.add_corner_contacts(spec, carried, spec.body(item.name), description.friction)
    for wire in description.wires:
        wires.add_wire(spec, wire, objects, description.step_s)
    if cell is not None:
        still = [item.name for item in description.objects if item.mass_kg == 0.0]
        ground = [FLOOR] if spec.body(FLOOR) is not None else []
        attach_cell(spec, cell, [*still, *ground])


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
        # dry friction opposes the speed at a step's end; MuJoCo's soft one lags, and may push a braking joint
        joint.solref_friction = [-1.0, -_STIFF_FRICTION / description.step_s]
        joint.solimp_friction = [_STIFF_FRICTION, _STIFF_FRICTION, 1e-3, 0.5, 2.0]
        servo = spec.add_actuator(
            name=f"{joint.name}_servo", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_pid(kp=stiffness, kv=damping, ctrlspec=all_inputs)
    mjcf_arm.add_shapes(spec, arm.shapes)
    for geom in spec.geoms:
        geom.density = 0.0  # a link without <inertial> has no mass, whatever its shapes
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _ROBOT_CONTACT
    # A separate massless body: loads act at its origin, and the sensor measures only these.
    mount = spec.body(arm.flange_frame).add_body(name=FLANGE_MOUNT)
    mount.add_site(name=FLANGE_SITE)
    for name, kind in (
        (FORCE_SENSOR, mujoco.mjtSensor.mjSENS_FORCE),
        (TORQUE_SENSOR, mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=FLANGE_SITE)
    _add_counter(spec, FLANGE_CONTACTS, (mujoco.mjtObj.mjOBJ_XBODY, FLANGE_MOUNT))


@final
class CompiledScene:
    """The compiled model of a scene; it is not changed after compiling.

    Args:
        description: of the scene.
        arms: further arms in it, see `compile_model`.

    Raises:
        InputError: MuJoCo refuses the arm's file or an object.
    """

    def __init__(self, description: SceneDescription, arms: tuple[SceneDescription, ...] = ()) -> None:
        engine.set_up_engine()
        self._model = compile_model(description, arms)
        self._arms = {one.prefix: one.arm for one in (description, *arms)}

    def model(self) -> mujoco.MjModel:
        """Return a copy of the model that may be changed."""
        return copy.copy(self._model)

    @cached_property
    def shapes(self) -> tuple[BodyShape, ...]:
        """Meshes of the bodies, for drawing."""
        shapes = body_shapes(self._model)
        for drawing in self.drawings.values():
            shapes = drawing.in_place_of(shapes)
        return shapes

    @cached_property
    def drawings(self) -> dict[str, drawn_arm.ArmDrawing]:
        """Drawing of each arm, by the prefix of its names."""
        return {prefix: drawn_arm.drawing_of(arm, self._model, prefix) for prefix, arm in self._arms.items()}
