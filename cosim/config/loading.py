"""Loads and checks scenarios, soft robots and studies from their TOML files or from Python, and writes a
scenario as TOML.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w

from cosim.base.resources import is_file, scenario_path, soft_robot_path
from cosim.config import arm_files, rules, studies
from cosim.config.cable_tensions import with_listed_tensions
from cosim.config.plugins import register_installed
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.phase import HOLD
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.soft_robot_files import RobotFiles
from cosim.config.tip_path_files import read_tip_paths
from cosim.config.toml import keys, parsing, reading
from cosim.config.toml.rules import Faults, check
from cosim.errors import InputError, ScenarioError

HEADER = "# The scenario as it ran, every value spelled out. Run it again with: cosim run <this file>\n"
_HEADER_GIVEN = (
    "# The scenario as it ran, every value spelled out; its soft body is in no file.\n"
    "# Run it again from Python: cosim.run(<this file>, body=...)\n"
)


def load_scenario(
    source: str | Path | Scenario,
    overrides: Mapping[str, Any] | None = None,
    body: GivenBodyTable | None = None,
) -> Scenario:
    """Return a checked scenario.

    Args:
        source: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"phase.inflate.pressure_Pa": 20e3}.
        body: replaces the scenario's soft robot, if it has one.

    Raises:
        InputError: there is no such scenario, or the overrides are not values by key path.
        ScenarioError: keys or values are wrong; each line of the message starts with a key's path.
    """
    if isinstance(source, Scenario):
        return loaded_scenario(to_table(source), Path(), by_key(overrides), body)
    path = scenario_path(source)
    table = reading.read_table(path)
    table.setdefault("name", path.stem)
    if "arm" in table:
        raise ScenarioError(
            "arm",
            f"{path.name} has several arms, which `cosim run` and `cosim.run_arms` step together; for all "
            "else give a file with the keys of one arm, without [[arm]]",
        )
    return loaded_scenario(table, path.parent, by_key(overrides), body)


def loaded_scenario(
    table: dict[str, Any], folder: Path, overrides: Mapping[str, Any], body: GivenBodyTable | None = None
) -> Scenario:
    """Return the checked scenario of a file's tables.

    Args:
        table: of the file; it is changed.
        folder: that relative paths start from.
        overrides: values by key path; paths in them start from the working directory.
        body: replaces the scenario's soft robot, if it has one.

    Raises:
        ScenarioError: keys or values are wrong; each line of the message starts with a key's path.
    """
    register_installed()
    overrides, faults = dict(overrides), Faults()
    scenario_folder = folder
    arm_folder = Path() if "robot" in overrides else folder
    scene_folder = Path() if any(key.partition(".")[0] == "scene" for key in overrides) else folder
    if body is not None:
        with faults:
            _check_no_robot(overrides, body)
        overrides = {key: value for key, value in overrides.items() if key.partition(".")[0] != "soft_robot"}
        table["soft_robot"] = to_table(body)
    elif "soft_robot" in overrides:
        table["soft_robot"] = overrides.pop("soft_robot")
        folder = Path()
    if "soft_robot" in table and body is None:
        table["soft_robot"] = _full_robot(table["soft_robot"], folder, faults)
    for key, value in overrides.items():
        if not faults.is_unread(key):
            with faults:
                reading.apply_override(table, key, reading.plain(value, key, faults.unread))
    path_folder = Path() if any(".tip_path" in key for key in overrides) else scenario_folder
    read_tip_paths(table, path_folder, faults)
    _resolve_files(table, scenario_folder, scene_folder)
    scenario = parsing.parse(Scenario, table, "", faults)
    with faults:
        scenario = replace(scenario, robot=arm_files.with_arm_path(scenario.robot, arm_folder))
    return _resolved(scenario, faults)


def _full_robot(robot: Any, folder: Path, faults: Faults) -> Any:
    """Return the full table of a scenario's soft robot; if a file is wrong, empty and not checked further."""
    with faults:
        _check_in_file(robot)
        return RobotFiles(faults).expand(robot, folder, "soft_robot")
    faults.unread["soft_robot"] = ""
    return {}


def _resolve_files(table: dict[str, Any], folder: Path, scene_folder: Path) -> None:
    """Make the paths of mesh files in a scenario's folder, and of the cell's file, absolute; in place."""
    objects, scene = table.get("object"), table.get("scene")
    for entry in [each for each in objects if isinstance(each, dict)] if isinstance(objects, list) else ():
        parts = entry.get("part")
        for solid in (entry, *(parts if isinstance(parts, list) else ())):
            file = solid.get("file") if isinstance(solid, dict) else None
            if isinstance(file, str) and is_file(folder / file):
                solid["file"] = str((folder / file).resolve())
    if isinstance(scene, dict) and isinstance(scene.get("mjcf"), str):
        file = scene_folder / scene["mjcf"]
        scene["mjcf"] = str(file.resolve() if is_file(file) else file)


def by_key(overrides: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a copy of overrides; an empty one for None.

    Raises:
        InputError: they are not values by key path.
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


def _check_in_file(soft_robot: object) -> None:
    """Check that a soft robot's table does not name a body given from Python, whose arrays are in no file.

    Raises:
        ScenarioError: it does.
    """
    if isinstance(soft_robot, dict) and "arrays" in soft_robot:
        raise ScenarioError(
            "soft_robot",
            f"'{soft_robot.get('name')}' was given as arrays, which are in no file: run this from Python, "
            "cosim.run(..., body=...), or continue with cosim.Simulation(..., body=..., start=...)",
        )


def load_soft_robot(name_or_path: str | Path) -> SoftRobotTable:
    """Return a checked soft robot from the name or path of its file.

    Raises:
        InputError: there is no such soft robot.
        ScenarioError: keys or values are wrong.
    """
    register_installed()
    path, faults = soft_robot_path(name_or_path), Faults()
    table = RobotFiles(faults).expand(str(path), Path(), "soft_robot")
    robot = parsing.parse(SoftRobotTable, table, "soft_robot", faults)
    check(robot, "soft_robot", None, (), faults)
    faults.raise_all()
    return robot


def is_scenario(table: Mapping[str, Any]) -> bool:
    """Return whether a file's tables describe a scenario; if not, they describe a soft robot."""
    return bool({"phase", "start", "soft_robot", "robot"} & table.keys())


def load_file(path: Path) -> Scenario | SoftRobotTable | studies.StudyTable:
    """Return the checked scenario, soft robot or study of a file, without building anything.

    Raises:
        ScenarioError: keys or values are wrong, or the file cannot be read.
    """
    table = reading.read_table(path)
    if studies.is_study(table):
        return studies.load_study(path)
    return load_scenario(path) if is_scenario(table) else load_soft_robot(path)


def _resolved(scenario: Scenario, faults: Faults) -> Scenario:
    """Check the rules of a scenario; return it with tensions as lists, zeros where the start omits them."""
    with faults:
        scenario = scenario if scenario.phases else replace(scenario, phases=(HOLD,))
    with faults:
        scenario = with_listed_tensions(scenario, faults)
    with faults:
        rules.check_scenario(scenario, faults)
    faults.raise_all()
    return scenario


def to_table(value: Any) -> Any:
    """Return a table's dataclass as nested dicts and lists; values that are None are left out."""
    if is_dataclass(value) and not isinstance(value, type):
        entries = ((keys.key_of(entry), getattr(value, entry.name)) for entry in fields(value))
        return {key: to_table(item) for key, item in entries if item is not None}
    if isinstance(value, tuple):
        return [to_table(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_table(item) for key, item in value.items()}
    return value


def scenario_text(scenario: Scenario) -> str:
    """Return a resolved scenario as TOML text. Loaded with the same body, it gives an equal scenario."""
    given = isinstance(scenario.soft_robot, GivenBodyTable)
    return (_HEADER_GIVEN if given else HEADER) + tomli_w.dumps(to_table(scenario))
