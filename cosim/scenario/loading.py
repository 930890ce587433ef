"""Loads scenario and soft-robot files into their frozen dataclasses."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from cosim.errors import InputError, ScenarioError
from cosim.resources import scenario_path, soft_robot_path
from cosim.scenario.checks import check_scenario, check_soft_robot
from cosim.scenario.mesh_lookup import with_mesh_paths
from cosim.scenario.overrides import apply_override, merge, plain
from cosim.scenario.parsing import describe, parse
from cosim.scenario.schema import Scenario
from cosim.scenario.soft_robot import SoftRobot
from cosim.scenario.tension_tables import list_tensions
from cosim.scenario.writing import to_table


def load_scenario(source: str | Path | Scenario, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Return a checked scenario.

    Args:
        source: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"phase.inflate.pressure_Pa": 20e3}.

    Raises:
        InputError: there is no such scenario.
        ScenarioError: a key or value is wrong; the message starts with the key's path.
    """
    overrides = dict(overrides or {})
    if isinstance(source, Scenario):
        table, folder = to_table(source), Path()
    else:
        path = scenario_path(source)
        table, folder = read_table(path), path.parent
        table.setdefault("name", path.stem)
    place = folder
    if "soft_robot" in overrides:
        apply_override(table, "soft_robot", overrides.pop("soft_robot"))
        folder = Path()
    if "soft_robot" in table:
        table["soft_robot"] = _expand_soft_robot(table["soft_robot"], folder)
    for key, value in overrides.items():
        apply_override(table, key, value)
    list_tensions(table, lambda: parse(SoftRobot, table.get("soft_robot", {}), "soft_robot").cable_names())
    scenario = parse(Scenario, table)
    return resolve(replace(scenario, objects=with_mesh_paths(scenario.objects, place)))


def load_soft_robot(name_or_path: str | Path) -> SoftRobot:
    """Return a checked soft robot, by name or path of its file.

    Raises:
        InputError: there is no such soft robot.
        ScenarioError: a key or value is wrong.
    """
    path = soft_robot_path(name_or_path)
    robot = parse(SoftRobot, _complete(read_table(path), path.parent, "soft_robot"), "soft_robot")
    check_soft_robot(robot, "soft_robot")
    return robot


def resolve(scenario: Scenario) -> Scenario:
    """Return the scenario with its rules checked and omitted start tensions filled with zeros.

    Raises:
        ScenarioError: see `cosim.scenario.checks`.
    """
    check_scenario(scenario)
    tensions = scenario.start.cable_tension_N or (0.0,) * len(scenario.soft_robot.cable_names())
    return replace(scenario, start=replace(scenario.start, cable_tension_N=tensions))


def read_table(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Raises:
        ScenarioError: the file cannot be read, or is not TOML; `path` is the file's name.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(str(path), f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(str(path), f"is not UTF-8 text: byte {error.start}") from error
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(str(path), f"is not TOML: {error}") from error


def question(path: Path) -> str:
    """Return the first paragraph of a scenario file's first comment: the question that it answers."""
    lines = takewhile(lambda line: line.strip("# "), path.read_text(encoding="utf-8").splitlines())
    comments = takewhile(lambda line: line.startswith("#"), lines)
    return " ".join(line.strip("# ") for line in comments).removeprefix("Question:").strip()


def _expand_soft_robot(value: Any, folder: Path, path: str = "soft_robot") -> Any:
    """Return the full table of a soft robot given by name, path, or changes to a file."""
    if isinstance(value, str):
        return _soft_robot_table(value, folder, path)
    return _complete(value, folder, path) if isinstance(value, Mapping) else value


def _complete(table: Mapping[str, Any], folder: Path, path: str) -> dict[str, Any]:
    """Return the table of a soft robot with the files that it and its attachments start from put in."""
    full = plain(table)
    if "file" in full:
        file = full.pop("file")
        if not isinstance(file, str):
            raise ScenarioError(f"{path}.file", f"expected a name or path, got {describe(file)}")
        full = merge(_soft_robot_table(file, folder, path), full)
    entries = full.get("attach")
    for entry in entries if isinstance(entries, list) else ():
        if isinstance(entry, dict) and "robot" in entry:
            where = f"{path}.attach.{entry.get('name', '?')}.robot"
            entry["robot"] = _expand_soft_robot(entry["robot"], folder, where)
    return dict(full)


def _soft_robot_table(name: str, folder: Path, path: str) -> dict[str, Any]:
    beside = folder / name
    try:
        file = beside if beside.suffix == ".toml" and beside.is_file() else soft_robot_path(name)
    except InputError as error:
        raise ScenarioError(path, str(error)) from error
    return _complete(read_table(file), file.parent, path)
