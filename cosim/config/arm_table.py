"""Schema of the file of an arm, `arm.toml`; and rails and turntables under an arm, put before its joints.

Poses as URDF writes them: `<origin xyz rpy>`, rotation = Rz(yaw) Ry(pitch) Rx(roll).

Lists have an entry for each joint from the base to the flange: angles in rad and torques in N m; of prismatic
joints lengths in m and forces in N.

A rigid piece between an arm's flange and the soft robot.
"""

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple, final

import numpy as np

from cosim.base.arm_file import ARMATURE, FIXED, ArmFile
from cosim.base.frames import Array, Pose
from cosim.config.toml.quantities import (
    Angle,
    Direction,
    Increasing,
    Length,
    Name,
    NonNegative,
    NonNegativeMass,
    Number,
    Position,
    Positive,
    PositiveAcceleration,
    PositiveForce,
    PositiveLength,
    PositiveMass,
    PositiveSpeed,
    PositiveTorque,
    Quaternion,
    Text,
    Vector3,
)
from cosim.config.toml.tables import Table
from cosim.errors import InputError


def text_of(values: Array) -> str:
    """Return numbers as a text that gives exactly the same numbers when read."""
    return " ".join(repr(float(value)) for value in values)


def add_origin(element: ElementTree.Element, pose: Pose) -> None:
    """Add the origin of a joint, shape or inertia, in its parent's frame."""
    r = pose.rotation
    upright = math.hypot(r[0, 0], r[1, 0])
    roll = math.atan2(r[2, 1], r[2, 2]) if upright > 1e-12 else math.atan2(-r[1, 2], r[1, 1])
    yaw = math.atan2(r[1, 0], r[0, 0]) if upright > 1e-12 else 0.0
    angles = np.array([roll, math.atan2(-r[2, 0], upright), yaw])
    ElementTree.SubElement(element, "origin", xyz=text_of(pose.translation), rpy=text_of(angles))


def link_of(joint: ElementTree.Element, end: str) -> str:
    """Return the name of a joint's parent or child."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def add_inertial(link: ElementTree.Element, mass_kg: float, pose: Pose, principal: Array) -> None:
    """Give a link its inertia.

    Args:
        link: that has none.
        mass_kg: of it.
        pose: of the centre of mass and principal axes, link frame.
        principal: (3,) [kg m^2], moments about these axes.
    """
    inertial = ElementTree.SubElement(link, "inertial")
    add_origin(inertial, pose)
    ElementTree.SubElement(inertial, "mass", value=repr(float(mass_kg)))
    moments = {key: repr(float(value)) for key, value in zip(("ixx", "iyy", "izz"), principal, strict=True)}
    ElementTree.SubElement(inertial, "inertia", moments, ixy="0", ixz="0", iyz="0")


def add_joint(
    robot: ElementTree.Element, name: str, kind: str, ends: tuple[str, str], pose: Pose
) -> ElementTree.Element:
    """Return a joint that is added to a robot.

    Args:
        robot: gets it.
        name: of the joint.
        kind: "fixed", or one of `cosim.base.arm_file.MOVING`.
        ends: links, parent and child.
        pose: parent from joint.
    """
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    for end, link in zip(("parent", "child"), ends, strict=True):
        ElementTree.SubElement(joint, end, link=link)
    add_origin(joint, pose)
    return joint


def add_cylinder(link: ElementTree.Element, tag: str, pose: Pose, radius: float, length: float) -> None:
    """Give a link a cylinder along z of a pose in its frame; tag: "visual" or "collision"."""
    shape = ElementTree.SubElement(link, tag)
    add_origin(shape, pose)
    size = {"radius": repr(float(radius)), "length": repr(float(length))}
    ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "cylinder", size)


def standing_along(axis: Array) -> Array:
    """Return a rotation (3, 3) whose z axis is a unit vector (3,)."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(axis, aside), axis], axis=1)


UNTURNED: Quaternion = (1.0, 0.0, 0.0, 0.0)


class BaseJoint(NamedTuple):
    """What rails and turntables have in common, in [m], [N] or in [rad], [N m].

    Args:
        kind: "prismatic" or "revolute".
        bounds: lowest and highest position.
        speed: largest.
        acceleration: largest; None: not known.
        effort: largest force or torque.
        center_m: world, of a point on the axis; None: the origin of the arm's root link.
    """

    kind: str
    bounds: tuple[float, float]
    speed: float
    acceleration: float | None
    effort: float
    center_m: Vector3 | None


@final
@dataclass(frozen=True)
class RailTable(Table):
    """Carries the arm along a line, on what comes before it.

    Args:
        axis: along which it slides, world.
        range_m: lowest and highest position; at 0 the arm stands where the base says.
        speed_m_s: largest.
        acceleration_m_s2: beyond which a motion is reported; omitted: none.
        force_N: largest; the stiffness of its servo follows from it, as of any joint.
        mass_kg: of the carriage.
        name: of the joint.
    """

    axis: Direction
    range_m: Annotated[tuple[Length, Length], Increasing]
    speed_m_s: PositiveSpeed
    acceleration_m_s2: PositiveAcceleration | None = None
    force_N: PositiveForce = 5e3
    mass_kg: PositiveMass = 50.0
    name: Name = "rail"

    @property
    def joint(self) -> BaseJoint:
        """What it is as a joint."""
        return BaseJoint(
            "prismatic", self.range_m, self.speed_m_s, self.acceleration_m_s2, self.force_N, None
        )


@final
@dataclass(frozen=True)
class TurntableTable(Table):
    """Turns the arm about an axis, on the rails.

    Args:
        range_rad: smallest and largest angle; at 0 the arm stands where the base says.
        speed_rad_s: largest.
        axis: world.
        center_m: a point on the axis, world, with rails at 0; omitted: the origin of the arm's root link.
        acceleration_rad_s2: beyond which a motion is reported; omitted: none.
        torque_Nm: largest; the stiffness of its servo follows from it, as of any joint.
        mass_kg: of the table, a disc of 0.2 m about its axis.
        name: of the joint.
    """

    range_rad: Annotated[tuple[Angle, Angle], Increasing]
    speed_rad_s: PositiveSpeed
    axis: Direction = (0.0, 0.0, 1.0)
    center_m: Position | None = None
    acceleration_rad_s2: Positive | None = None
    torque_Nm: PositiveTorque = 2e3
    mass_kg: PositiveMass = 50.0
    name: Name = "turntable"

    @property
    def joint(self) -> BaseJoint:
        """What it is as a joint."""
        return BaseJoint(
            "revolute", self.range_rad, self.speed_rad_s, self.acceleration_rad_s2, self.torque_Nm,
            self.center_m,
        )  # fmt: skip


@final
@dataclass(frozen=True)
class BaseTable(Table):
    """Where the root link of the arm stands, and what moves it.

    Args:
        position_m: of its origin, world.
        quaternion: (w, x, y, z), world from root link; normalised on use.
        rails: `[[arm_base.rail]]` in the file (of an arm `[[base.rail]]`), each on the one before; several
            make a gantry.
        turntables: `[[arm_base.turntable]]` in the file, each on the one before, the first on the last rail.
    """

    position_m: Position = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UNTURNED
    rails: tuple[RailTable, ...] = field(default=(), metadata={"alias": "rail"})
    turntables: tuple[TurntableTable, ...] = field(default=(), metadata={"alias": "turntable"})


@final
@dataclass(frozen=True)
class AdapterTable(Table):
    """A rigid piece between the arm's flange and the soft robot: a cylinder from one to the other.

    Args:
        position_m: where soft robots are mounted, flange frame.
        quaternion: (w, x, y, z), flange from mounting face; normalised on use.
        mass_kg: of the cylinder.
        radius_m: of the cylinder.
    """

    position_m: Position
    quaternion: Quaternion = UNTURNED
    mass_kg: NonNegativeMass = 0.0
    radius_m: PositiveLength = 0.03


@final
@dataclass(frozen=True)
class LimitsTable(Table):
    """Bounds of the joints in place of those in the arm's file.

    Args:
        lower: smallest angles; continuous joints get them too, with `upper`.
        upper: largest angles.
        velocity: largest speeds.
        acceleration: beyond which a motion is reported.
        effort: largest torques.
        assumed: which of these, or of those in the arm's file, no data sheet states; every run says so.
    """

    lower: tuple[Number, ...] | None = None
    upper: tuple[Number, ...] | None = None
    velocity: tuple[Positive, ...] | None = None
    acceleration: tuple[Positive, ...] | None = None
    effort: tuple[Positive, ...] | None = None
    assumed: tuple[Literal["lower", "upper", "velocity", "acceleration", "effort"], ...] = ()


@final
@dataclass(frozen=True)
class ServosTable(Table):
    """Servos of the joints: torque = stiffness times error of the angle + damping times that of the speed.

    Args:
        stiffness: N m/rad; omitted: from the torque limits.
        damping: N m s/rad; omitted: a fifth of the stiffness.
        armature: rotor inertia seen at the joint, kg m^2; omitted: the file's, or 0.1.
    """

    stiffness: tuple[Positive, ...] | None = None
    damping: tuple[NonNegative, ...] | None = None
    armature: tuple[NonNegative, ...] | None = None


@final
@dataclass(frozen=True)
class ArmTable(Table):
    """A rigid arm.

    Args:
        file: URDF (.urdf) or MJCF (.xml), beside this file, or package://NAME/..., or menagerie:MODEL.
        title: what it is.
        flange: link, or site of an MJCF, whose frame is the flange: z out of its face. Omitted:
            attachment_site, tool0, flange, or the last link before the chain branches or ends.
        home: joint angles far from singularities, from which the plan starts to look; omitted: the file's,
            or one is found.
        package_paths: folders in which the NAME of package://NAME/... is looked for, beside the folders above
            the file and the robots of the package example-robot-data.
        drawn_as: menagerie:MODEL, the same arm with the same zero of its joints: if it is on this machine,
            its meshes are drawn in recordings and by cameras. Motion and forces do not depend on it.
    """

    file: Text
    title: Text | None = None
    flange: Text | None = None
    home: tuple[Number, ...] | None = None
    package_paths: tuple[Text, ...] = ()
    drawn_as: Text | None = None
    base: BaseTable = BaseTable()
    adapter: AdapterTable | None = None
    limits: LimitsTable = LimitsTable()
    servos: ServosTable = ServosTable()


ADAPTER: Final = "adapter"


def add_adapter(robot: ElementTree.Element, flange: str, adapter: AdapterTable, path: Path) -> str:
    """Add a rigid cylinder from the flange to where soft robots are mounted; return the link there.

    I = m (3 r^2 + l^2) / 12 across its axis and m r^2 / 2 along it.

    Args:
        robot: gets a link and a fixed joint more.
        flange: link that carries it.
        adapter: what it is.
        path: of the arm's file.

    Raises:
        InputError: a link has its name already, or it has a mass but no length.
    """
    if any(link.get("name") == ADAPTER for link in robot.findall("link")):
        raise InputError(f"arm file {path}: a link is called {ADAPTER!r}, so no adapter can be added")
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


_WORLD: Final = "world"  # MuJoCo's, which no joint may carry
_RADIUS_M: Final = 0.2  # of carriages, as they are drawn and turn
_THICK_M: Final = 0.04
_BEAM_M: Final = 0.05


def on_moving_base(arm: ArmFile, base: BaseTable) -> ArmFile:
    """Return an arm whose root link is carried by the rails of a base, and by turntables on these.

    All joints of the base are at 0 where the root link is at `arm.world_from_base`. The home has them in the
    middle of their ranges.

    Args:
        arm: as its file has it; joints of a base that it has already come after the new ones.
        base: of the arm; without rails and turntables the arm is returned as it is.

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
    """Return the name of the root link; that of MuJoCo's world is changed."""
    children = {link_of(joint, "child") for joint in robot.iter("joint")}
    root = next(link for link in robot.iter("link") if link.get("name") not in children)
    if root.get("name") == _WORLD:
        root.set("name", "arm_root")
        for parent in robot.iter("parent"):
            if parent.get("link") == _WORLD:
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
        robot: gets a joint and a link.
        parent: link of `robot`.
        carrier: what is added.
        axis: (3,) of length 1, in axes of the arm's root link.
        place: (3,) [m], of the joint in its parent, the same axes.
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
