"""The JSON Schema of the files: shipped files fit it, what it says of a key is what the program does."""

from __future__ import annotations

import json
import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from cosim.base.resources import (
    arm_path,
    list_arms,
    list_scenarios,
    list_soft_robots,
    scenario_path,
    soft_robot_path,
)
from cosim.cli.main import main
from cosim.config.json_schema import json_schema
from cosim.config.loading import load_scenario, scenario_text
from cosim.config.several_arms import has_arms, load_arms
from cosim.errors import ScenarioError

KINDS = ("scenario", "robot", "arm")
SCENARIO, ROBOT, ARM = (json.loads(json.dumps(json_schema(kind))) for kind in KINDS)
REFERENCE = tomllib.loads(scenario_path("ur5e_hexagon_arm").read_text(encoding="utf-8"))


def paths(schema: dict[str, Any], table: dict[str, Any]) -> list[str]:
    found = [error.json_path.removeprefix("$.") for error in Draft202012Validator(schema).iter_errors(table)]
    return sorted(found)


def table(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def test_they_are_schemas() -> None:
    for schema in (SCENARIO, ROBOT, ARM):
        Draft202012Validator.check_schema(schema)
        assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.parametrize("name", list_scenarios())
def test_every_scenario_fits_its_schema(name: str) -> None:
    assert paths(SCENARIO, table(scenario_path(name))) == []
    text = load_arms(name).text() if has_arms(name) else scenario_text(load_scenario(name))
    assert paths(SCENARIO, tomllib.loads(text)) == []


@pytest.mark.parametrize("name", list_soft_robots())
def test_every_robot_fits_its_schema(name: str) -> None:
    assert paths(ROBOT, table(soft_robot_path(name))) == []


@pytest.mark.parametrize("name", list_arms())
def test_every_arm_fits_its_schema(name: str) -> None:
    assert paths(ARM, table(arm_path(name))) == []
    assert paths(ARM, {**table(arm_path(name)), "flang": "tool0", "home": [0.0, "x"]}) == ["$", "home[1]"]


WRONG: dict[str, tuple[str, Any]] = {
    "unknown key": ("clock.tck_s", 0.1),
    "type": ("phase.0.duration_s", "1"),
    "bound": ("clock.tick_s", 0.2),
    "magnitude": ("phase.1.duration_s", 1e12),
    "choice": ("mode", "static"),
    "length": ("gravity_m_s2", [0.0, 0.0]),
    "pattern": ("phase.0.name", "a b"),
    "kind of value": ("start.pressure_Pa", "high"),
    "not a table": ("solver", 5),
    "old number": ("schema", 1),
    "robot": ("soft_robot", 5),
}


@pytest.mark.parametrize(("path", "value"), WRONG.values(), ids=WRONG)
def test_what_the_schema_refuses_the_program_refuses(path: str, value: object, tmp_path: Path) -> None:
    wrong: Any = deepcopy(REFERENCE)
    *parents, last = path.split(".")
    here = wrong
    for part in parents:
        here = here[int(part)] if part.isdecimal() else here[part]
    here[last] = value
    assert len(paths(SCENARIO, wrong)) == 1
    counted = ".".join(str(int(part) + 1) if part.isdecimal() else part for part in path.split("."))
    with pytest.raises(ScenarioError):
        load_scenario("ur5e_hexagon_arm", {counted: value})


def test_a_key_is_told_with_unit_bounds_default_and_meaning() -> None:
    settle = SCENARIO["$defs"]["PhaseTable"]["properties"]["settle_s"]
    assert settle == {
        "default": 0.0,
        "description": "time after the ramp in which the end values are held. Unit: s.",
        "maximum": 1e9,
        "minimum": 0.0,
        "type": "number",
        "x-unit": "s",
    }
    gravity = SCENARIO["properties"]["gravity_m_s2"]
    assert (gravity["x-unit"], gravity["default"]) == ("m/s^2", [0.0, 0.0, -9.81])
    phase = SCENARIO["$defs"]["PhaseTable"]["properties"]
    assert [phase[f"cell_speed_{unit}"]["x-unit"] for unit in ("m_s", "rad_s")] == ["m/s", "rad/s"]
    law = ROBOT["$defs"]["FilmTable"]["properties"]["law"]
    assert law["enum"] == ["plain", "tension_field", "edge_strain", "wrinkling", "neo_hookean"]
    assert law["description"].startswith('"plain": linear elastic; "tension_field": ')
    assert ROBOT["$defs"]["FilmTable"]["description"] == "Elastic sheet of the chamber walls."


@pytest.mark.parametrize(("kind", "schema"), [("scenario", SCENARIO), ("robot", ROBOT), ("arm", ARM)])
def test_the_command_prints_it(kind: str, schema: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", kind]) == 0
    assert json.loads(capsys.readouterr().out) == schema
