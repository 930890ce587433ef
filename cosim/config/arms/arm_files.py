"""Finds the file of an arm, by name or by path, and what its `arm.toml` says."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cosim.base.resources import arm_path, is_file, list_arms
from cosim.config.arms.arm_reading import ArmSource, read_urdf
from cosim.config.arms.arm_table import ArmTable
from cosim.config.arms.menagerie import PREFIX, is_of_menagerie, menagerie_file
from cosim.config.arms.package_files import DATA_PACKAGE, found_file, packaged_share
from cosim.config.toml.faults import Faults
from cosim.config.toml.parsing import parse
from cosim.config.toml.reading import read_table
from cosim.config.toml.suggestions import unknown_name_message
from cosim.errors import InputError, ScenarioError

ARM_SUFFIXES: Final = (".urdf", ".xml", ".toml", ".xacro")
_TABLE_FILE: Final = "arm.toml"


def is_arm_path(robot: str) -> bool:
    """Return whether what names an arm leads to a file: whether it ends like one, or is of the Menagerie."""
    return is_of_menagerie(robot) or Path(robot).suffix.lower() in ARM_SUFFIXES


def is_arm_file(path: Path) -> bool:
    """Return whether a file is that of an arm: by its ending, its name, or what its key `file` ends in."""
    if path.suffix.lower() != ".toml":
        return is_arm_path(path.name)
    return path.name == _TABLE_FILE or is_arm_table(read_table(path))


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
    if is_of_menagerie(robot):
        place = robot
    elif is_file(path):
        place = str(path.resolve())
    else:
        raise ScenarioError("robot", f"arm file {path} does not exist")
    try:
        source = arm_source(place)
        if not source.is_mjcf:
            read_urdf(source)
    except ScenarioError:
        raise
    except InputError as error:
        raise ScenarioError("robot", str(error)) from error
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
        if robot not in list_arms():
            raise InputError(unknown_arm(robot))
        return _from_table(arm_path(robot))
    if is_of_menagerie(robot):
        found = menagerie_file(robot)
        return ArmSource(robot.removeprefix(PREFIX), found, ArmTable(file=found.name))
    path = Path(robot)
    if not is_file(path):
        raise InputError(f"arm file {path} does not exist")
    if path.suffix.lower() == ".toml":
        return _from_table(path)
    return ArmSource(path.stem, path, ArmTable(file=path.name))


def unknown_arm(robot: str, others: tuple[str, ...] = ()) -> str:
    """Return what to say about a name that no arm has.

    Args:
        robot: the name.
        others: names that may stand in its place, besides those of arms.
    """
    known = unknown_name_message("arm", robot, (*list_arms(), *others))
    return f"{known}; or give the path of a .urdf, an .xml (MJCF) or an arm.toml, or menagerie:MODEL"


def read_arm_table(path: Path) -> ArmTable:
    """Return what an `arm.toml` says.

    Raises:
        ScenarioError: keys or values are wrong, or the file cannot be read.
    """
    faults = Faults()
    table = parse(ArmTable, read_table(path), "robot", faults)
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
    folders = tuple(
        _package_folder(path.parent / folder, k) for k, folder in enumerate(table.package_paths, start=1)
    )
    name = path.resolve().parent.name if path.name == _TABLE_FILE else path.stem
    try:
        file = found_file(table.file, path, folders)
    except InputError as error:
        if DATA_PACKAGE in table.file and packaged_share() is None:
            raise InputError(
                f"arm {name!r} is read from the package {DATA_PACKAGE}, which is not installed; install it"
            ) from None
        raise InputError(f"arm file {path}: file {error}") from None
    return ArmSource(name, file, table, folders, (path,))
