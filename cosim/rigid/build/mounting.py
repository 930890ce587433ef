"""Mounts an arm and its tool: adds rails and turntables under the arm, and the adapter on its flange, to its
URDF.
"""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from cosim.base.arm_file import ARMATURE, FIXED, ArmFile
from cosim.base.frames import Array, Pose
from cosim.config.arm_table import AdapterTable, BaseTable, RailTable, TurntableTable
from cosim.errors import InputError
from cosim.rigid.build.arm_tree import ROOT
from cosim.rigid.build.urdf_elements import (
    add_cylinder,
    add_inertial,
    add_joint,
    link_of,
    standing_along,
    text_of,
)

ADAPTER: Final = "adapter"
_RADIUS_M: Final = 0.2  # of carriages, drawn and for their inertia
_THICK_M: Final = 0.04  # of carriages
_BEAM_M: Final = 0.05  # radius of the cylinder that shows a rail


def add_adapter(robot: ElementTree.Element, flange: str, adapter: AdapterTable, path: Path) -> str:
    """Add an adapter, a rigid cylinder from the flange to the mounting face; return the name of its link.

    Its moments of inertia are m (3 r^2 + l^2) / 12 across its axis and m r^2 / 2 along it.

    Args:
        robot: top element of the URDF; gets a link and a fixed joint.
        flange: name of the link that carries the adapter.
        adapter: its table.
        path: of the arm's file, for messages.

    Raises:
        InputError: a link is called "adapter" already, or the adapter has a mass but no length.
    """
    if any(link.get("name") == ADAPTER for link in robot.findall("link")):
        raise InputError(
            f"arm file {path}: a link is called {ADAPTER!r}, so no adapter can be added; rename it"
        )
    end = Pose.from_quaternion(np.array(adapter.quaternion), np.array(adapter.position_m))
    length, radius, mass_kg = float(np.linalg.norm(end.translation)), adapter.radius_m, adapter.mass_kg
    link = ElementTree.SubElement(robot, "link", name=ADAPTER)
    add_joint(robot, f"{ADAPTER}_joint", FIXED, (flange, ADAPTER), end)
    if length == 0.0 and mass_kg > 0.0:
        raise InputError(f"arm file {path}: an adapter of length 0 has no mass; leave mass_kg out")
    if length == 0.0:
        return ADAPTER
    middle = end.inverse() @ Pose(standing_along(end.translation / length), 0.5 * end.translation)
    if mass_kg > 0.0:
        across, along = mass_kg * (3.0 * radius**2 + length**2) / 12.0, 0.5 * mass_kg * radius**2
        add_inertial(link, mass_kg, middle, np.array([across, across, along]))
    for tag in ("visual", "collision"):
        add_cylinder(link, tag, middle, radius, length)
    return ADAPTER


def on_moving_base(arm: ArmFile, base: BaseTable) -> ArmFile:
    """Return an arm whose root link stands on the turntables and rails of a base.

    With all joints of the base at 0 the root link is at `arm.world_from_base`. The home has them in the
    middle of their ranges.

    Args:
        arm: as its file describes it. If it has a moving base already, the new joints come before that.
        base: of the arm; without rails and turntables the arm is returned unchanged.

    Raises:
        InputError: a name of a joint or link is used twice.
    """
    carriers: list[RailTable | TurntableTable] = [*base.rails, *base.turntables]
    if not carriers:
        return arm
    robot, names = ElementTree.fromstring(arm.urdf), [carrier.name for carrier in carriers]
    root = _root_of(robot)
    links = {element.get("name", "") for element in robot.iter("link")}
    for k, name in enumerate(names):
        if name in (*arm.joint_names, *names[:k]) or _of(name) in links:
            raise InputError(
                f"arm {arm.name!r}: two joints are called {name!r}; give the one of its base another name"
            )
    parent, place = ElementTree.SubElement(robot, "link", name=f"{names[0]}_ground"), np.zeros(3)
    for carrier in carriers:
        center = carrier.joint.center_m or arm.world_from_base.translation
        point = arm.world_from_base.inverse().apply(np.array(center))
        axis = arm.world_from_base.rotation.T @ np.array(carrier.axis)
        parent = _carried(robot, parent, carrier, axis / np.linalg.norm(axis), point - place)
        place = point
    add_joint(robot, f"{names[-1]}_mount", FIXED, (parent.get("name", ""), root), Pose(np.eye(3), -place))
    joints, count = [carrier.joint for carrier in carriers], len(carriers)
    bounds = [np.inf if joint.acceleration is None else joint.acceleration for joint in joints]
    unknown = np.full(count, np.nan)  # gains that follow from the largest force or torque
    stiffness, damping = arm.servo_stiffness, arm.servo_damping
    return replace(
        arm,
        urdf=ElementTree.tostring(robot, encoding="unicode"),
        joint_names=(*names, *arm.joint_names),
        home=np.concatenate([[np.mean(joint.bounds) for joint in joints], arm.home]),
        acceleration_bound=np.concatenate([bounds, arm.acceleration_bound]),
        armature=np.concatenate([np.full(count, ARMATURE), arm.armature]),
        servo_stiffness=None if stiffness is None else np.concatenate([unknown, stiffness]),
        servo_damping=None if damping is None else np.concatenate([unknown, damping]),
    )


def _of(name: str) -> str:
    """Return the name of the link that a joint of a base carries."""
    return f"{name}_carriage"


def _root_of(robot: ElementTree.Element) -> str:
    """Return the name of the root link; a root called "world" is renamed, because MuJoCo reserves that."""
    children = {link_of(joint, "child") for joint in robot.iter("joint")}
    root = next(link for link in robot.iter("link") if link.get("name") not in children)
    if root.get("name") == ROOT:
        root.set("name", "arm_root")
        for parent in robot.iter("parent"):
            if parent.get("link") == ROOT:
                parent.set("link", "arm_root")
    return root.get("name", "")


def _carried(
    robot: ElementTree.Element,
    parent: ElementTree.Element,
    carrier: RailTable | TurntableTable,
    axis: Array,
    place: Array,
) -> ElementTree.Element:
    """Add a rail or a turntable; return the link that it carries.

    Args:
        robot: top element of the URDF; gets a joint and a link.
        parent: link of `robot` that the carrier stands on.
        carrier: the rail or turntable.
        axis: (3,) of length 1, in axes of the arm's root link.
        place: (3,) [m], position of the joint in its parent, same axes.
    """
    of, sliding = carrier.joint, carrier.joint.kind == "prismatic"
    link = ElementTree.SubElement(robot, "link", name=_of(carrier.name))
    ends = parent.get("name", ""), _of(carrier.name)
    joint = add_joint(robot, carrier.name, of.kind, ends, Pose(np.eye(3), place))
    ElementTree.SubElement(joint, "axis", xyz=text_of(axis))
    limits = {"lower": of.bounds[0], "upper": of.bounds[1], "velocity": of.speed, "effort": of.effort}
    ElementTree.SubElement(joint, "limit", {key: repr(value) for key, value in limits.items()})
    flat = Pose(np.eye(3) if sliding else standing_along(axis), np.zeros(3))
    mass, radius, height = carrier.mass_kg, _RADIUS_M, _THICK_M
    across = mass * (3.0 * radius**2 + height**2) / 12.0
    add_inertial(link, mass, flat, np.array([across, across, 0.5 * mass * radius**2]))
    add_cylinder(link, "visual", flat @ Pose(np.eye(3), np.array([0.0, 0.0, -0.5 * height])), radius, height)
    if sliding:  # seen from its one end to the other, below the carriage
        lower, upper = of.bounds
        middle = place + 0.5 * (lower + upper) * axis - np.array([0.0, 0.0, height + _BEAM_M])
        add_cylinder(parent, "visual", Pose(standing_along(axis), middle), _BEAM_M, upper - lower)
    return link
