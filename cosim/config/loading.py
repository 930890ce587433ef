"""Loads scenario and soft-robot files into their frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cosim.base.resources import scenario_path, soft_robot_path
from cosim.config.arms.arm_files import with_arm_path
from cosim.config.kinds import register_installed
from cosim.config.rules.given_body_rules import check_in_file
from cosim.config.rules.scenario_rules import check_scenario, check_soft_robot
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.mesh_paths import with_mesh_paths, with_scene_path
from cosim.config.schema.phase import HOLD
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.studies.study_files import is_study, load_study
from cosim.config.studies.study_table import StudyTable
from cosim.config.tension_tables import with_listed_tensions
from cosim.config.tip_path_files import complete_tip_paths
from cosim.config.toml.faults import UNKNOWN, Faults, copy_with
from cosim.config.toml.overrides import apply_override
from cosim.config.toml.parsing import parse
from cosim.config.toml.reading import read_table
from cosim.config.toml.robot_files import RobotFiles
from cosim.config.writing import to_table
from cosim.errors import InputError, ScenarioError


def load_scenario(
    source: str | Path | Scenario,
    overrides: Mapping[str, Any] | None = None,
    body: GivenBodyTable | None = None,
) -> Scenario:
    """Return a checked scenario.

    Args:
        source: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"phase.inflate.pressure_Pa": 20e3}.
        body: takes the place of the scenario's soft robot, if it has one.

    Raises:
        InputError: there is no such scenario, or the overrides are no values by key path.
        ScenarioError: keys or values are wrong; each line of the message starts with a key's path.
    """
    register_installed()
    overrides, faults = _by_key(overrides), Faults()
    if isinstance(source, Scenario):
        table, folder = to_table(source), Path()
    else:
        path = scenario_path(source)
        table, folder = read_table(path), path.parent
        table.setdefault("name", path.stem)
    place = folder
    arm_folder = Path() if "robot" in overrides else folder
    scene_folder = Path() if any(key.partition(".")[0] == "scene" for key in overrides) else folder
    if body is not None:
        with faults:
            _check_no_robot(overrides, body)
        table["soft_robot"] = UNKNOWN
    elif "soft_robot" in overrides:
        apply_override(table, "soft_robot", overrides.pop("soft_robot"))
        folder = Path()
    if "soft_robot" in table and body is None:
        robot, table["soft_robot"] = table["soft_robot"], UNKNOWN
        with faults:
            check_in_file(robot)
            table["soft_robot"] = RobotFiles(faults).expand(robot, folder, "soft_robot")
    for key, value in overrides.items():
        with faults:
            apply_override(table, key, value)
    path_folder = Path() if any(".tip_path" in key for key in overrides) else place
    complete_tip_paths(table, path_folder, faults)
    scenario = parse(Scenario, table, "", faults)
    if body is not None:
        scenario = copy_with(scenario, soft_robot=body)
    with faults:
        scenario = copy_with(scenario, objects=with_mesh_paths(scenario.objects, place, faults))
    with faults:
        scenario = copy_with(scenario, robot=with_arm_path(scenario.robot, arm_folder))
    with faults:
        scenario = copy_with(scenario, scene=with_scene_path(scenario.scene, scene_folder))
    return _resolved(scenario, faults)


def _by_key(overrides: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a copy of overrides.

    Raises:
        InputError: they are none.
    """
    if overrides is None:
        return {}
    if not isinstance(overrides, Mapping) or not all(isinstance(key, str) for key in overrides):
        raise InputError(
            f"overrides or changes are {overrides!r:.60}; give values by key path, such as "
            '{"clock.tick_s": 1e-3}'
        )
    return dict(overrides)


def _check_no_robot(overrides: Mapping[str, Any], body: GivenBodyTable) -> None:
    for key in overrides:
        if key.partition(".")[0] == "soft_robot":
            raise ScenarioError(key, f"cannot be set: the soft body '{body.name}' is given as arrays")


def load_soft_robot(name_or_path: str | Path) -> SoftRobotTable:
    """Return a checked soft robot, by name or path of its file.

    Raises:
        InputError: there is no such soft robot.
        ScenarioError: keys or values are wrong.
    """
    register_installed()
    path, faults = soft_robot_path(name_or_path), Faults()
    table = RobotFiles(faults).expand(str(path), Path(), "soft_robot")
    robot = parse(SoftRobotTable, table, "soft_robot", faults)
    check_soft_robot(robot, "soft_robot", faults)
    faults.tell()
    return robot


def is_scenario(table: Mapping[str, Any]) -> bool:
    """Return whether a file's tables are those of a scenario; otherwise they are those of a soft robot."""
    return bool({"phase", "start", "soft_robot", "robot"} & table.keys())


def load_file(path: Path) -> Scenario | SoftRobotTable | StudyTable:
    """Return what a scenario, robot or study file describes, checked without building anything.

    Raises:
        ScenarioError: keys or values are wrong, or the file cannot be read.
    """
    table = read_table(path)
    if is_study(table):
        return load_study(path)
    return load_scenario(path) if is_scenario(table) else load_soft_robot(path)


def resolve(scenario: Scenario) -> Scenario:
    """Return the scenario with its rules checked and its tensions listed, zeros where the start omits them.

    Raises:
        ScenarioError: see `cosim.config.rules.scenario_rules`.
    """
    return _resolved(scenario, Faults())


def _resolved(scenario: Scenario, faults: Faults) -> Scenario:
    with faults:
        scenario = scenario if scenario.phases else copy_with(scenario, phases=(HOLD,))
    with faults:
        scenario = with_listed_tensions(scenario, faults)
    with faults:
        check_scenario(scenario, faults)
    faults.tell()
    return scenario
