"""Finds the file of an arm, by name or by path, and makes an arm of it and of its `arm.toml`.

Makes an arm of a robot's links and joints and of what its `arm.toml` says.
"""

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from cosim.base import arm_file, resources
from cosim.base.frames import Array, Pose
from cosim.config import arm_chain, arm_table, robot_tree
from cosim.config.toml import parsing, reading
from cosim.config.toml.keys import unknown_name_message
from cosim.errors import InputError, ScenarioError

LEFT_OUT: Final = "left out, because not on the way to the flange"


@final
@dataclass(frozen=True)
class ArmSource:
    """Where an arm is read from.

    Args:
        name: as asked for.
        path: of the URDF or MJCF.
        table: of its `arm.toml`, or what represents one.
        package_folders: in which packages are looked for first.
        files: what has been read already.
    """

    name: str
    path: Path
    table: arm_table.ArmTable
    package_folders: tuple[Path, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def is_mjcf(self) -> bool:
        """Whether it is MuJoCo's own format, by its ending."""
        return self.path.suffix.lower() == ".xml"


@final
@dataclass(frozen=True)
class Chain:
    """Links and joints from the root to the flange, as URDF.

    Args:
        robot: nothing else is in it.
        joints: of it, base to flange.
        flange: link whose frame is the flange.
        home: (joints,) of the arm's file; None: it has none.
        armature: (joints,) [kg m^2] of the arm's file; None: it has none.
        shapes: see `ArmFile`.
        files: that it was read from.
        notes: see `ArmFile`.
    """

    robot: ElementTree.Element
    joints: tuple[ElementTree.Element, ...]
    flange: str
    home: Array | None = None
    armature: Array | None = None
    shapes: tuple[arm_file.LinkShape, ...] = ()
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()


def read_urdf(source: ArmSource) -> arm_file.ArmFile:
    """Return the arm of a URDF file; only the chain from the root to the flange is kept.

    The bound of a joint's acceleration is the attribute `acceleration` of its `<limit>`, if there is one.
    Hands, fingers and helper frames off the chain are left out: the flange carries the soft robot.

    Raises:
        InputError: file, flange, package or mesh missing, text not XML, a joint type not handled, or numbers
            that belong to no arm.
    """
    path, robot = source.path, robot_tree.read_robot(source.path)
    flange, how = arm_chain.flange_of(robot, source.table.flange, path)
    joints = arm_chain.chain_to(robot, flange, path)
    check_limited_chain(robot, joints, source)
    links = {flange} | {robot_tree.link_of(joint, "parent") for joint in joints}
    left_out = []
    for element in list(robot):
        is_link = element.tag == "link" and element.get("name") in links
        if not (is_link or element in joints or element.tag == "material"):
            robot.remove(element)
            masses = [mass.get("value", "0").strip() for mass in element.iter("mass")]
            if element.tag == "link" and any(mass not in ("0", "0.0") for mass in masses):
                left_out.append(element.get("name", ""))
    meshes = arm_chain.find_meshes(robot, path, source.package_folders)
    notes = (f"flange '{flange}', {how}", *arm_chain.replace_unreadable(robot))
    if left_out:
        notes += (f"{LEFT_OUT}: {', '.join(left_out)}",)
    return arm_of(Chain(robot, tuple(joints), flange, files=(path, *meshes), notes=notes), source)


def arm_of(chain: Chain, source: ArmSource) -> arm_file.ArmFile:
    """Return the arm of a chain, with what its `arm.toml` says put in.

    Raises:
        InputError: a list has not as many entries as there are joints, or values that no joint has.
    """
    table, path, flange = source.table, source.path, chain.flange
    moving = arm_chain.moving_joints(list(chain.joints))
    names = tuple(joint.get("name", "") for joint in moving)
    home, known = _home(moving, chain, source)
    if table.adapter is not None:
        flange = arm_table.add_adapter(chain.robot, flange, table.adapter, path)
    armature = _of_joints(table.servos.armature, "servos.armature", names, source)
    if armature is None:
        armature = np.zeros(0) if chain.armature is None else chain.armature
    stiffness = _of_joints(table.servos.stiffness, "servos.stiffness", names, source)
    damping = _of_joints(table.servos.damping, "servos.damping", names, source)
    bound = [_acceleration_bound(joint, _where(joint, path)) for joint in moving]
    base = table.base
    arm = arm_file.ArmFile(
        source.name,
        path,
        ElementTree.tostring(chain.robot, encoding="unicode"),
        flange,
        names,
        home,
        np.array(bound),
        armature,
        stiffness,
        damping,
        Pose.from_quaternion(np.array(base.quaternion), np.array(base.position_m)),
        home_known=known,
        shapes=chain.shapes,
        files=(*source.files, *chain.files),
        notes=(*chain.notes, *_unbounded(moving), *_assumed(table.limits.assumed)),
        drawn_as=table.drawn_as,
    )
    return arm_table.on_moving_base(arm, base)


def assumed_limits(robot: str) -> list[str]:
    """Return a line on the limits of an arm that no data sheet states; none for arms whose limits are stated.

    Args:
        robot: name or path of an arm, see `arm_source`.
    """
    return [f"{robot}: {part}" for part in _assumed(arm_source(robot).table.limits.assumed)]


def _assumed(limits: tuple[str, ...]) -> list[str]:
    """Return which limits are assumed, as parts of a sentence."""
    return [f"assumed limits, not from a data sheet: {', '.join(limits)}"] if limits else []


def _unbounded(moving: list[ElementTree.Element]) -> list[str]:
    """Return which joints have no bound of torque or speed, as parts of a sentence."""
    found = []
    for key in ("effort", "velocity"):
        names = [joint.get("name", "") for joint in moving if float(_limit_of(joint).get(key, "0")) == 0.0]
        if names:
            found.append(f"no {key} limit in the file, so none is checked: {', '.join(names)}")
    return found


def check_limited_chain(
    robot: ElementTree.Element, joints: list[ElementTree.Element], source: ArmSource
) -> None:
    """Write the limits of an `arm.toml` over those of a chain's joints, then check links and joints.

    Raises:
        InputError: a list has not as many entries as there are joints; see `check_chain`.
    """
    moving, limits = arm_chain.moving_joints(joints), source.table.limits
    names = tuple(joint.get("name", "") for joint in moving)
    for key in ("lower", "upper", "velocity", "acceleration", "effort"):
        values = _of_joints(getattr(limits, key), f"limits.{key}", names, source)
        for joint, value in zip(moving, () if values is None else values.tolist(), strict=False):
            _limit_of(joint).set(key, repr(value))
    for joint in moving:
        given = [key for key in ("lower", "upper") if getattr(limits, key) is not None]
        if joint.get("type") == "continuous" and len(given) == 1:
            raise InputError(
                f"{_where(joint, source.path)}: turns without limits; limits.{given[0]} alone bounds one "
                "side only, give both"
            )
        if joint.get("type") == "continuous" and given:
            joint.set("type", "revolute")
    arm_chain.check_chain(robot, joints, source.path)
    for joint in moving:
        _fill(_limit_of(joint), ("effort", "velocity"))
    for inertia in robot.iter("inertia"):
        _fill(inertia, ("ixy", "ixz", "iyz"))


def _fill(element: ElementTree.Element, keys: tuple[str, ...]) -> None:
    """Write 0 for what is left out: engines refuse elements without it."""
    for key in keys:
        if element.get(key) is None:
            element.set(key, "0")


def _limit_of(joint: ElementTree.Element) -> ElementTree.Element:
    """Return the limit of a joint, added if it has none."""
    found = joint.find("limit")
    return ElementTree.SubElement(joint, "limit") if found is None else found


def _where(joint: ElementTree.Element, path: Path) -> str:
    return f"arm file {path}: joint {joint.get('name')!r}"


def _of_joints(
    values: tuple[float, ...] | None, key: str, names: tuple[str, ...], source: ArmSource
) -> Array | None:
    """Return a list of `arm.toml` that has an entry for each joint; None where it is left out."""
    if values is not None and len(values) != len(names):
        raise InputError(
            f"arm {source.name!r}: {key} has {len(values)} entries; there are {len(names)} joints: "
            f"{', '.join(names)}"
        )
    return None if values is None else np.array(values, dtype=np.float64)


def _acceleration_bound(joint: ElementTree.Element, where: str) -> float:
    """Return the attribute `acceleration` of a joint's limit [rad/s^2]; infinite without one."""
    limit = joint.find("limit")
    if limit is None or limit.get("acceleration") is None:
        return np.inf
    return float(arm_chain.numbers(limit, "acceleration", 1, "", where)[0])


def _home(moving: list[ElementTree.Element], chain: Chain, source: ArmSource) -> tuple[Array, bool]:
    """Return the home of an arm, and whether anybody has given it; otherwise it is as near 0 as can be."""
    names = tuple(joint.get("name", "") for joint in moving)
    given = _of_joints(source.table.home, "home", names, source)
    home = chain.home if given is None else given
    bounds = np.array([_bounds(joint) for joint in moving])
    if home is None:
        return np.clip(np.zeros(len(names)), bounds[:, 0], bounds[:, 1]), False
    outside = (home < bounds[:, 0]) | (home > bounds[:, 1])
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"{_where(moving[k], source.path)}: its home {home[k]:g} is outside its limits, {bounds[k, 0]:g} "
            f"to {bounds[k, 1]:g}"
        )
    return home, True


def _bounds(joint: ElementTree.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    if joint.get("type") == "continuous" or limit is None:
        return -np.inf, np.inf
    return float(limit.get("lower", "0")), float(limit.get("upper", "0"))


ARM_SUFFIXES: Final = (".urdf", ".xml", ".toml", ".xacro")
_TABLE_FILE: Final = "arm.toml"


def is_arm_path(robot: str) -> bool:
    """Return whether what names an arm leads to a file: whether it ends like one, or is of the Menagerie."""
    return robot_tree.is_of_menagerie(robot) or Path(robot).suffix.lower() in ARM_SUFFIXES


def is_arm_file(path: Path) -> bool:
    """Return whether a file is that of an arm: by its ending, its name, or what its key `file` ends in."""
    if path.suffix.lower() != ".toml":
        return is_arm_path(path.name)
    return path.name == _TABLE_FILE or is_arm_table(reading.read_table(path))


def is_arm_table(table: Mapping[str, Any]) -> bool:
    """Return whether a file's table is that of an arm: whether it starts from a URDF or MJCF."""
    file = str(table.get("file", ""))
    return is_arm_path(file) and not file.endswith(".toml")


def with_arm_path(robot: str, folder: Path) -> str:
    """Return what names an arm in a scenario, a file as its absolute path.

    Args:
        robot: as in the file.
        folder: that relative paths start from.

    Raises:
        ScenarioError: there is no such file, it is not usable, or keys or values of an `arm.toml` are wrong.
    """
    if not is_arm_path(robot):
        return robot
    path = folder / robot
    if robot_tree.is_of_menagerie(robot):
        place = robot
    elif resources.is_file(path):
        place = str(path.resolve())
    else:
        raise ScenarioError("robot", f"arm file {path} does not exist")
    with reading.blamed_on("robot"):
        source = arm_source(place)
        if not source.is_mjcf:
            read_urdf(source)
    return place


def arm_source(robot: str) -> ArmSource:
    """Return where an arm is read from.

    Args:
        robot: one of `list_arms()`, the path of a URDF (.urdf), an MJCF (.xml) or an `arm.toml`, or a model
            of the Menagerie, see `menagerie_file`.

    Raises:
        InputError: unknown name, or there is no such file.
        ScenarioError: keys or values of an `arm.toml` are wrong.
    """
    if not is_arm_path(robot):
        if robot not in resources.list_arms():
            raise InputError(unknown_arm(robot))
        return _from_table(resources.arm_path(robot))
    if robot_tree.is_of_menagerie(robot):
        found = robot_tree.menagerie_file(robot)
        return ArmSource(robot.removeprefix(robot_tree.PREFIX), found, arm_table.ArmTable(file=found.name))
    path = Path(robot)
    if not resources.is_file(path):
        raise InputError(f"arm file {path} does not exist")
    if path.suffix.lower() == ".toml":
        return _from_table(path)
    return ArmSource(path.stem, path, arm_table.ArmTable(file=path.name))


def unknown_arm(robot: str, others: tuple[str, ...] = ()) -> str:
    """Return what to say about a name that no arm has.

    Args:
        robot: the name.
        others: names that may stand in its place, besides those of arms.
    """
    known = unknown_name_message("arm", robot, (*resources.list_arms(), *others))
    return f"{known}; or give the path of a .urdf, an .xml (MJCF) or an arm.toml, or menagerie:MODEL"


def read_arm_table(path: Path) -> arm_table.ArmTable:
    """Return what an `arm.toml` says.

    Raises:
        ScenarioError: keys or values are wrong, or the file cannot be read.
    """
    faults = reading.Faults()
    table = parsing.parse(arm_table.ArmTable, reading.read_table(path), "robot", faults)
    faults.tell()
    return table


def _package_folder(path: Path, number: int) -> Path:
    """Return an entry of `package_paths`, counted from 1, as an absolute path.

    Raises:
        ScenarioError: it is no folder, or cannot be read.
    """
    try:
        os.scandir(path).close()
    except OSError as error:
        raise ScenarioError(
            f"robot.package_paths.{number}",
            f"'{path!s:.200}' is no folder that can be read: {error.strerror}; name the folder that holds "
            "the packages, or leave the entry out",
        ) from error
    return path.resolve()


def _from_table(path: Path) -> ArmSource:
    table = read_arm_table(path)
    if table.drawn_as is not None and not robot_tree.is_of_menagerie(table.drawn_as):
        raise ScenarioError(
            "robot.drawn_as",
            f"'{table.drawn_as:.80}' is no model of the Menagerie; write {robot_tree.PREFIX}MODEL",
        )
    folders = tuple(
        _package_folder(path.parent / folder, k) for k, folder in enumerate(table.package_paths, start=1)
    )
    name = path.resolve().parent.name if path.name == _TABLE_FILE else path.stem
    try:
        file = robot_tree.found_file(table.file, path, folders)
    except InputError as error:
        if robot_tree.DATA_PACKAGE in table.file and robot_tree.packaged_share() is None:
            raise InputError(
                f"arm {name!r} is read from the package {robot_tree.DATA_PACKAGE}, which is not installed"
                "; install it"
            ) from None
        raise InputError(f"arm file {path}: file {error}") from None
    return ArmSource(name, file, table, folders, (path,))
