"""Scenarios load, resolve, round-trip and take overrides."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.resources import first_comment, list_scenarios, list_soft_robots, scenario_path
from cosim.config.loading import load_scenario, load_soft_robot, scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.config.several_arms import has_arms
from cosim.config.toml.reading import apply_override, merge, parse_assignment
from cosim.errors import InputError, ScenarioError

REFERENCE = "ur5e_hexagon_arm"


@pytest.mark.parametrize("name", [name for name in list_scenarios() if not has_arms(name)])
def test_a_resolved_scenario_loads_to_itself(name: str, tmp_path: Path) -> None:
    scenario = load_scenario(name)
    resolved = tmp_path / "other_name.toml"
    resolved.write_text(scenario_text(scenario), encoding="utf-8")
    assert load_scenario(resolved) == scenario
    assert load_scenario(scenario) == scenario


@pytest.mark.parametrize("name", list_scenarios())
def test_every_scenario_says_which_question_it_answers(name: str) -> None:
    assert first_comment(scenario_path(name)).endswith("?")


@pytest.mark.parametrize("name", list_soft_robots())
def test_every_soft_robot_loads_and_names_its_source(name: str) -> None:
    robot = load_soft_robot(name)
    assert robot.name == name
    assert robot.source


def test_the_reference_scenario_holds_the_papers_numbers() -> None:
    scenario = load_scenario(REFERENCE)
    robot = scenario.soft_robot
    assert [phase.name for phase in scenario.phases] == ["hang", "inflate", "turn", "lift", "reach"]
    assert sum(phase.increments for phase in scenario.phases) == 380
    nodes = 7 * robot.stack.sides * robot.stack.units + robot.stack.sides
    # 0.02 N per node; the mass per node is written with 16 digits
    assert nodes * robot.mass.node_mass_kg * 9.81 == pytest.approx(8.52, rel=1e-14)
    assert scenario.phases[1].pressure_Pa == 30e3
    turn = scenario.phases[2].flange_turn
    assert turn is not None
    assert abs(turn.angle_rad) == pytest.approx(0.28 * np.pi, rel=1e-15)
    # the tip, at (0, 0, -1) from the flange, must swing towards +x
    assert np.cross(np.array(turn.axis) * turn.angle_rad, [0.0, 0.0, -1.0])[0] > 0.0


@pytest.mark.parametrize(("parent", "value"), [("start", [0.1, 0.2]), ("ticks", 3), ("mode", "dynamic")])
def test_overrides_enter_nothing_but_tables(parent: str, value: object) -> None:
    tables = {parent: value}
    with pytest.raises(ScenarioError, match=f"^{parent}.1: cannot be set: {parent} is not a table$"):
        apply_override(tables, f"{parent}.1.more", 0.0)
    assert tables == {parent: value}


@pytest.mark.parametrize(
    ("key", "value", "remedy"),
    [
        ("start.flange.position_m[0]", 0.4, "start.flange.position_m=[0.3, 0.0, 0.7]"),
        ("phase[1].duration_s", 2.0, "phase.inflate.duration_s;"),
        ("phase[lift].duration_s", 2.0, "phase.lift.duration_s;"),
        ("phase[99].duration_s", 2.0, "phase.hang.duration_s;"),
        ("soft_robot.cable[0].corner", 1, "soft_robot.cable.right.corner;"),
    ],
)
def test_a_place_in_brackets_is_refused_with_a_key_that_works(key: str, value: float, remedy: str) -> None:
    with pytest.raises(ScenarioError, match=rf"^{re.escape(key)}: ") as refused:
        load_scenario(REFERENCE, {key: value})
    assert f" {remedy}" in f"{refused.value};"
    named, _, whole = remedy.rstrip(";").partition("=")
    load_scenario(REFERENCE, {named: json.loads(whole) if whole else value})


def test_overrides_reach_every_kind_of_place() -> None:
    scenario = load_scenario(
        REFERENCE,
        {
            "mode": "quasistatic",
            "phase.inflate.pressure_Pa": 20e3,
            "phase.1.duration_s": 2,
            "phase.turn.flange_turn.angle_rad": 0.1,
            "soft_robot.film.thickness_m": 2e-4,
            "soft_robot.cable.left.capstan_factor": 0.9,
            "start.cable_tension_N": np.array([1.0, 2.0]),
        },
    )
    assert scenario.mode == "quasistatic"
    assert scenario.phases[1].pressure_Pa == 20e3
    assert scenario.phases[0].duration_s == 2.0
    assert scenario.phases[2].flange_turn is not None
    assert scenario.phases[2].flange_turn.angle_rad == 0.1
    assert scenario.soft_robot.film.thickness_m == 2e-4
    assert [cable.capstan_factor for cable in scenario.soft_robot.cables] == [0.8, 0.9]
    assert scenario.start.cable_tension_N == (1.0, 2.0)


def test_an_override_changes_nothing_else() -> None:
    plain, changed = load_scenario(REFERENCE), load_scenario(REFERENCE, {"clock.tick_s": 0.001})
    assert replace(changed, clock=plain.clock) == plain
    assert changed.clock.tick_s == 0.001


def test_a_soft_robot_can_be_a_file_with_changes(tmp_path: Path) -> None:
    text = scenario_text(load_scenario(REFERENCE))
    table = tomllib.loads(text)
    full = table["soft_robot"]
    start = text.index("[soft_robot]")
    end = text.index("[start]")
    changed = '[soft_robot]\nfile = "hexagon_arm"\n[soft_robot.film]\nthickness_m = 3e-4\n\n'
    path = tmp_path / "mine.toml"
    path.write_text(text[:start] + changed + text[end:], encoding="utf-8")
    robot = load_scenario(path).soft_robot
    assert robot.film.thickness_m == 3e-4
    assert robot.film.young_modulus_Pa == full["film"]["young_modulus_Pa"]


def test_omitted_start_tensions_become_one_zero_per_cable() -> None:
    assert load_scenario(REFERENCE, {"start.cable_tension_N": []}).start.cable_tension_N == (0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("k=1", 1),
        ("k=20e3", 20e3),
        ("k=.5", 0.5),
        ("k=true", True),
        ("k=quasistatic", "quasistatic"),
        ('k="quasistatic"', "quasistatic"),
        ("k = [1, 2]", [1, 2]),
        ("k={axis=[0,1,0], angle_rad=0.1}", {"axis": [0, 1, 0], "angle_rad": 0.1}),
    ],
)
def test_assignments_are_toml_or_bare_text(text: str, value: object) -> None:
    key, parsed = parse_assignment(text)
    assert key == "k"
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize("text", ["novalue", "=3", "a..b=1", ".a=1"])
def test_assignments_without_key_or_value_are_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match="key=value"):
        parse_assignment(text)


def test_merge_goes_into_tables_and_replaces_lists() -> None:
    base = {"a": {"x": 1, "y": [1, 2]}, "b": 2}
    assert merge(base, {"a": {"y": [3]}}) == {"a": {"x": 1, "y": [3]}, "b": 2}
    assert base["a"] == {"x": 1, "y": [1, 2]}


def test_a_missing_scenario_names_those_that_exist() -> None:
    with pytest.raises(InputError, match=REFERENCE):
        load_scenario("nope")


@settings(deadline=None)
@given(st.text(min_size=1).filter(str.strip))
def test_any_text_survives_the_resolved_file(title: str) -> None:
    try:
        title.encode()
    except UnicodeEncodeError:
        return  # lone surrogates are no text that a file could hold
    scenario = replace(load_scenario(REFERENCE), title=title)
    assert tomllib.loads(scenario_text(scenario))["title"] == title


def test_every_schema_class_is_frozen() -> None:
    def walk(value: object) -> None:
        assert type(value).__dataclass_params__.frozen  # type: ignore[attr-defined]
        for entry in fields(value):  # type: ignore[arg-type]
            inner = getattr(value, entry.name)
            for item in inner if isinstance(inner, tuple) else (inner,):
                if is_dataclass(item):
                    walk(item)

    scenario = load_scenario(REFERENCE)
    assert isinstance(scenario, Scenario)
    walk(scenario)
