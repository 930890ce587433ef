"""What robot files say of how their values are known."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from cosim.base.resources import list_soft_robots, soft_robot_path
from cosim.build.expected_error import known_report
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.schema.soft_robot import StiffenerTable
from cosim.errors import ScenarioError

NO_VALUES = {"schema", "name", "source", "base", "file", "known", "element"}


@pytest.mark.parametrize("name", list_soft_robots())
def test_every_table_of_a_robot_s_file_is_said_to_be_known_somehow(name: str) -> None:
    with soft_robot_path(name).open("rb") as file:
        given = tomllib.load(file).keys() - NO_VALUES
    known = load_soft_robot(name).known
    assert given <= {*known.published, *known.measured, *known.identified, *known.assumed}


@pytest.mark.parametrize("name", list_soft_robots())
def test_no_robot_claims_that_its_stiffeners_are_published(name: str) -> None:
    robot = load_soft_robot(name)
    assert "stiffener" in robot.known.assumed


@pytest.mark.parametrize(
    ("known", "path", "message"),
    [
        ({"published": ["film.thickness"]}, "known.published", "'film.thickness'; the robot has no such key"),
        ({"measured": ["hinge.rule.x"]}, "known.measured", "no such key"),
        ({"published": ["film"], "assumed": ["film"]}, "known", "names 'film' more than once"),
        ({"identified": ["film"], "assumed": ["film"]}, "known", "names 'film' more than once"),
        ({"identified": ["stiffener.side"]}, "known.identified", "no such key"),
        ({"assumed": ["9" * 5000]}, "known.assumed", r"9\.\.\.; the robot has no such key"),
        ({"guessed": ["film"]}, "known.guessed", "unknown key"),
    ],
)  # fmt: skip
def test_a_key_that_there_is_not_is_refused(known: dict[str, list[str]], path: str, message: str) -> None:
    nothing = {"published": [], "measured": [], "identified": [], "assumed": []}
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario("three_unit_inflation", {"soft_robot.known": {**nothing, **known}})
    assert caught.value.path.startswith(f"soft_robot.{path}")


def test_a_run_says_what_is_assumed_and_of_the_paper_s_model_only_what_is_left() -> None:
    told = known_report(load_scenario("sealed_arm"))
    assert "assumed: stack.mesh, stack.refine_holes, stack.neck, film.law, stiffener" in told
    published = known_report(load_scenario("sealed_arm", {"model.published": True}))
    assert "stiffener" not in published
    assert "mass" in published


@pytest.mark.parametrize(
    "changes",
    [
        {"soft_robot": {"file": "square_core", "stiffener": {"kind": "none"}}},
        {"soft_robot.stiffener.kind": "none"},
    ],
)
def test_bare_film_is_one_line(changes: dict[str, Any]) -> None:
    bare = load_scenario("three_unit_inflation", changes)
    assert bare.soft_robot.stiffener == StiffenerTable()


def test_an_entry_of_a_list_keeps_its_name_with_another_kind() -> None:
    before = load_scenario("bending_angle_control").controllers[0]
    changes = {"controller.paper.kind": "pi", "controller.paper.proportional": 0.1}
    with pytest.raises(ScenarioError) as caught:
        load_scenario("bending_angle_control", {**changes, "controller.paper.period_s": -1.0})
    assert before.name == "paper"
    assert "controller.paper.period_s" in str(caught.value)
