"""Finds the file of an arm by name or path, and reads its `arm.toml`."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from cosim.base import resources
from cosim.config import arm_table, menagerie, packages
from cosim.config.toml import parsing, reading
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Faults, errors_at
from cosim.errors import InputError, ScenarioError

ARM_SUFFIXES: Final = (".urdf", ".xml", ".toml", ".xacro")
_TABLE_FILE: Final = "arm.toml"


@final
@dataclass(frozen=True)
class ArmSource:
    """The files of an arm, and its `arm.toml`.

    Args:
        name: of the arm.
        path: of the URDF or MJCF.
        table: of its `arm.toml`; for a URDF or MJCF without one, a table with defaults.
        package_folders: folders that are searched first for packages.
        files: that have been read.
    """

    name: str
    path: Path
    table: arm_table.ArmTable
    package_folders: tuple[Path, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def is_mjcf(self) -> bool:
        """Whether the arm's file is an MJCF, by its ending."""
        return self.path.suffix.lower() == ".xml"


def assumed_limits(robot: str) -> list[str]:
    """Return a line that lists the limits of an arm that no data sheet states; empty if all are stated.

    Args:
        robot: name or path of an arm, see `arm_source`.
    """
    return [f"{robot}: {part}" for part in assumed(arm_source(robot).table.limits.assumed)]


def assumed(limits: tuple[str, ...]) -> list[str]:
    """Return a phrase that lists assumed limits; empty for none."""
    return [f"assumed limits, not from a data sheet: {', '.join(limits)}"] if limits else []


def is_arm_path(robot: str) -> bool:
    """Return whether the text that names an arm is a path, by its ending, or a model of the Menagerie."""
    return menagerie.is_of_menagerie(robot) or Path(robot).suffix.lower() in ARM_SUFFIXES


def is_arm_file(path: Path) -> bool:
    """Return whether a file describes an arm, by its ending, its name, or the ending of its key `file`."""
    if path.suffix.lower() != ".toml":
        return is_arm_path(path.name)
    return path.name == _TABLE_FILE or is_arm_table(reading.read_table(path))


def is_arm_table(table: Mapping[str, Any]) -> bool:
    """Return whether a file's table describes an arm: whether its key `file` is a URDF or MJCF."""
    file = table.get("file")
    return isinstance(file, str) and is_arm_path(file) and not file.endswith(".toml")


def with_arm_path(robot: str, folder: Path) -> str:
    """Return the `robot` of a scenario with a path made absolute.

    Args:
        robot: name or path of an arm, as in the scenario's file.
        folder: that relative paths start from.

    Raises:
        ScenarioError: there is no such file, or keys or values of an `arm.toml` are wrong.
    """
    if not is_arm_path(robot):
        return robot
    path = folder / robot
    if menagerie.is_of_menagerie(robot):
        resolved = robot
    elif resources.is_file(path):
        resolved = str(path.resolve())
    else:
        raise ScenarioError("robot", f"arm file {path} does not exist")
    with errors_at("robot"):
        arm_source(resolved)
    return resolved


def arm_source(robot: str) -> ArmSource:
    """Return the files and table of an arm.

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
    if menagerie.is_of_menagerie(robot):
        file = menagerie.menagerie_file(robot)
        return ArmSource(robot.removeprefix(menagerie.PREFIX), file, arm_table.ArmTable(file=file.name))
    path = Path(robot)
    if not resources.is_file(path):
        raise InputError(f"arm file {path} does not exist")
    if path.suffix.lower() == ".toml":
        return _from_table(path)
    return ArmSource(path.stem, path, arm_table.ArmTable(file=path.name))


def unknown_arm(robot: str, others: tuple[str, ...] = ()) -> str:
    """Return the message for an unknown arm.

    Args:
        robot: the unknown name.
        others: names that are allowed in addition to those of arms.
    """
    known = unknown_name_message("arm", robot, (*resources.list_arms(), *others))
    return f"{known}; or give the path of a .urdf, an .xml (MJCF) or an arm.toml, or menagerie:MODEL"


def read_arm_table(path: Path) -> arm_table.ArmTable:
    """Return the table of an `arm.toml`.

    Raises:
        ScenarioError: keys or values are wrong, or the file cannot be read.
    """
    faults = Faults()
    table = parsing.parse(arm_table.ArmTable, reading.read_table(path), "robot", faults)
    faults.raise_all()
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
    if table.drawn_as is not None and not menagerie.is_of_menagerie(table.drawn_as):
        raise ScenarioError(
            "robot.drawn_as",
            f"'{table.drawn_as:.80}' is no model of the Menagerie; write {menagerie.PREFIX}MODEL",
        )
    folders = tuple(
        _package_folder(path.parent / folder, k) for k, folder in enumerate(table.package_paths, start=1)
    )
    name = path.resolve().parent.name if path.name == _TABLE_FILE else path.stem
    try:
        file = packages.resolve_file(table.file, path, folders)
    except InputError as error:
        raise InputError(f"arm file {path}: file {error}") from None
    return ArmSource(name, file, table, folders, (path,))
