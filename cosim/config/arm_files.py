"""Finds the file of an arm, by name or by path, and reads its `arm.toml`."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from cosim.base import resources
from cosim.config import arm_table, robot_files
from cosim.config.toml import parsing, reading
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Faults, blamed_on
from cosim.errors import InputError, ScenarioError


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


def assumed_limits(robot: str) -> list[str]:
    """Return a line on the limits of an arm that no data sheet states; none for arms whose limits are stated.

    Args:
        robot: name or path of an arm, see `arm_source`.
    """
    return [f"{robot}: {part}" for part in assumed(arm_source(robot).table.limits.assumed)]


def assumed(limits: tuple[str, ...]) -> list[str]:
    """Return which limits are assumed, as parts of a sentence."""
    return [f"assumed limits, not from a data sheet: {', '.join(limits)}"] if limits else []


ARM_SUFFIXES: Final = (".urdf", ".xml", ".toml", ".xacro")
_TABLE_FILE: Final = "arm.toml"


def is_arm_path(robot: str) -> bool:
    """Return whether what names an arm leads to a file: whether it ends like one, or is of the Menagerie."""
    return robot_files.is_of_menagerie(robot) or Path(robot).suffix.lower() in ARM_SUFFIXES


def is_arm_file(path: Path) -> bool:
    """Return whether a file is that of an arm: by its ending, its name, or what its key `file` ends in."""
    if path.suffix.lower() != ".toml":
        return is_arm_path(path.name)
    return path.name == _TABLE_FILE or is_arm_table(reading.read_table(path))


def is_arm_table(table: Mapping[str, Any]) -> bool:
    """Return whether a file's table is that of an arm: whether it starts from a URDF or MJCF."""
    file = table.get("file")
    return isinstance(file, str) and is_arm_path(file) and not file.endswith(".toml")


def with_arm_path(robot: str, folder: Path) -> str:
    """Return what names an arm in a scenario, a file as its absolute path.

    Args:
        robot: as in the file.
        folder: that relative paths start from.

    Raises:
        ScenarioError: there is no such file, or keys or values of an `arm.toml` are wrong.
    """
    if not is_arm_path(robot):
        return robot
    path = folder / robot
    if robot_files.is_of_menagerie(robot):
        place = robot
    elif resources.is_file(path):
        place = str(path.resolve())
    else:
        raise ScenarioError("robot", f"arm file {path} does not exist")
    with blamed_on("robot"):
        arm_source(place)
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
    if robot_files.is_of_menagerie(robot):
        found = robot_files.menagerie_file(robot)
        return ArmSource(robot.removeprefix(robot_files.PREFIX), found, arm_table.ArmTable(file=found.name))
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
    faults = Faults()
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
    if table.drawn_as is not None and not robot_files.is_of_menagerie(table.drawn_as):
        raise ScenarioError(
            "robot.drawn_as",
            f"'{table.drawn_as:.80}' is no model of the Menagerie; write {robot_files.PREFIX}MODEL",
        )
    folders = tuple(
        _package_folder(path.parent / folder, k) for k, folder in enumerate(table.package_paths, start=1)
    )
    name = path.resolve().parent.name if path.name == _TABLE_FILE else path.stem
    try:
        file = robot_files.found_file(table.file, path, folders)
    except InputError as error:
        raise InputError(f"arm file {path}: file {error}") from None
    return ArmSource(name, file, table, folders, (path,))
