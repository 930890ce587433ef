"""Loads scenario and soft-robot files into their frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from cosim.base.resources import scenario_path, soft_robot_path
from cosim.config.rules.scenario_rules import check_scenario, check_soft_robot
from cosim.config.schema.mesh_paths import with_mesh_paths
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.tension_tables import list_tensions
from cosim.config.toml.overrides import apply_override
from cosim.config.toml.parsing import parse
from cosim.config.toml.reading import check_values, read_table
from cosim.config.toml.robot_files import RobotFiles
from cosim.config.writing import to_table


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
        table["soft_robot"] = RobotFiles().expand(table["soft_robot"], folder, "soft_robot")
    for key, value in overrides.items():
        apply_override(table, key, value)
    check_values(table)
    list_tensions(
        table, lambda: parse(SoftRobotTable, table.get("soft_robot", {}), "soft_robot").cable_names()
    )
    scenario = parse(Scenario, table)
    return resolve(replace(scenario, objects=with_mesh_paths(scenario.objects, place)))


def load_soft_robot(name_or_path: str | Path) -> SoftRobotTable:
    """Return a checked soft robot, by name or path of its file.

    Raises:
        InputError: there is no such soft robot.
        ScenarioError: a key or value is wrong.
    """
    path = soft_robot_path(name_or_path)
    table = RobotFiles().table(str(path), Path(), "soft_robot")
    check_values(table, "soft_robot")
    robot = parse(SoftRobotTable, table, "soft_robot")
    check_soft_robot(robot, "soft_robot")
    return robot


def resolve(scenario: Scenario) -> Scenario:
    """Return the scenario with its rules checked and omitted start tensions filled with zeros.

    Raises:
        ScenarioError: see `cosim.config.rules.scenario_rules`.
    """
    check_scenario(scenario)
    tensions = scenario.start.cable_tension_N or (0.0,) * len(scenario.soft_robot.cable_names())
    return replace(scenario, start=replace(scenario.start, cable_tension_N=tensions))


def question(path: Path) -> str:
    """Return the first paragraph of a scenario file's first comment: the question that it answers."""
    lines = takewhile(lambda line: line.strip("# "), path.read_text(encoding="utf-8").splitlines())
    comments = takewhile(lambda line: line.startswith("#"), lines)
    return " ".join(line.strip("# ") for line in comments).removeprefix("Question:").strip()
