"""Every wrong key of a file is told at once, one line each."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cosim.base.resources import scenario_path
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.errors import ScenarioError

REFERENCE = "ur5e_hexagon_arm"


def refusal(overrides: dict[str, object], scenario: str | Path = REFERENCE) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(scenario, overrides)
    return caught.value


WRONG_VALUES = {
    "clock.tck_s": 0.001,  # unknown key
    "phase.inflate.pressure_Pa": "30 kPa",  # type
    "phase.turn.duration_s": -1.0,  # bound
    "gravity_m_s2": [0.0, -9.81],  # length
    "start.flange.direction": [0.0, 0.0, 0.0],  # a rule on one value
    "film.law": "plain",  # a table that there is not
}
BROKEN_RULES = {
    "soft_robot.cable.left.corner": 6,  # of the soft robot
    "soft_robot.stack.hole_radius_m": 0.04,  # of one table
    "phase.lift.clamp": ["unit_99.outer"],  # across tables
    "phase.turn.settle_s": 1e9,
    "robot": "ur6e",
}


def test_wrong_keys_and_values_are_told_together() -> None:
    error = refusal({**WRONG_VALUES, **BROKEN_RULES})
    assert {path for path, _ in error.faults} == {*WRONG_VALUES, "film"} - {"film.law"}
    assert str(error).split("\n") == [f"{path}: {problem}" for path, problem in error.faults]


def test_broken_rules_are_told_together_once_every_value_is_right() -> None:
    error = refusal(BROKEN_RULES)
    assert {path for path, _ in error.faults} == BROKEN_RULES.keys()
    assert str(error).split("\n") == [f"{path}: {problem}" for path, problem in error.faults]


def test_no_rule_is_told_that_follows_from_a_misspelt_key() -> None:
    error = refusal({"phase.reach.tip_target": {"hight_m": 0.5, "reach_with": "cables"}})
    assert error.faults == (("phase.reach.tip_target.hight_m", "unknown key; did you mean height_m?"),)
    start = {"pressure_Pa": 0.0, "flage": {"position_m": [0.3, 0.0, 0.7], "direction": [0.0, 0.0, -1.0]}}
    assert [path for path, _ in refusal({"start": start}).faults] == ["start.flage"]
    cable = {"name": "left", "corner": 1, "units": [1, 10], "capstan": 0.8}
    error = refusal({"soft_robot.cable": [cable], "start.cable_tension_N": [0.0]})
    assert [path for path, _ in error.faults] == ["soft_robot.cable.left.capstan"]


def test_no_rule_is_told_of_a_value_that_is_wrong_by_itself() -> None:
    assert refusal({"soft_robot.stack.units": "ten"}).path == "soft_robot.stack.units"
    assert len(refusal({"soft_robot.stack.units": "ten"}).faults) == 1


def test_a_robot_that_is_not_there_hides_no_other_fault() -> None:
    error = refusal({"soft_robot": "hexagon_leg", "soft_robot.film.thickness_m": 1e-4, "mode": "static"})
    assert [path for path, _ in error.faults] == ["soft_robot", "mode"]


def test_files_of_an_object_and_its_parts_are_told(tmp_path: Path) -> None:
    ball = {"shape": "mesh", "file": "reel.stl"}
    solid = {"name": "a", "position_m": [0.0, 0.0, 0.0], "part": [ball, ball], **ball}
    error = refusal({"object": [solid]})
    assert [path for path, _ in error.faults] == [
        "object.a.file", "object.a.part.1.file", "object.a.part.2.file"
    ]  # fmt: skip


def test_names_used_twice_are_told_together() -> None:
    ball = {"shape": "sphere", "size_m": [0.1], "position_m": [0.0, 0.0, 0.0]}
    balls = [{"name": name, **ball} for name in ("a", "c", "a", "b")]
    wire = {"name": "b", "points_m": [[0, 0, 0], [0, 0, 1]], "radius_m": 0.01, "mass_kg": 1.0}
    assert [path for path, _ in refusal({"object": balls, "wire": [wire]}).faults] == ["object.a", "wire.b"]


def test_at_most_twenty_lines_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = [word for k in range(23) for word in ("--set", f"wrong_{k:02}=1")]
    assert main(["run", REFERENCE, *wrong]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("cosim: error: wrong_00: unknown key")
    assert lines[19].startswith("cosim: error: wrong_19: unknown key")
    assert lines[20:] == ["cosim: error: ... and 3 more"]


def test_a_truth_value_is_no_number_and_a_number_no_text() -> None:
    values: dict[str, object] = {"schema": True, "clock.tick_s": True, "title": 5, "contact.enabled": 1}
    assert {path for path, _ in refusal(values).faults} == values.keys()
    assert refusal({"schema": 2.0}).faults == (("schema", "got the number 2.0; allowed: 2"),)
    assert load_scenario(REFERENCE, {"phase.inflate.pressure_Pa": 30000}).phases[1].pressure_Pa == 30e3


@pytest.mark.parametrize("arguments", [["list"], ["--help"]])
def test_pydantic_is_imported_only_where_a_file_is_read(arguments: list[str]) -> None:
    code = (
        "import contextlib, sys, cosim; from cosim.cli.main import main\n"
        f"with contextlib.suppress(SystemExit): main({arguments!r})\n"
        "print('pydantic' in sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "False"


def test_a_file_is_read_with_the_same_faults_as_overrides(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    text = scenario_path(REFERENCE).read_text(encoding="utf-8")
    path.write_text(text.replace("tick_s = 0.01 ", "tick_s = 0").replace("settle_s", "setle_s", 1))
    assert [place for place, _ in refusal({}, path).faults] == ["phase.hang.setle_s", "clock.tick_s"]


def test_a_name_with_a_line_break_is_told_in_one_line() -> None:
    error = refusal({"phase.inflate.pump_pressure_Pa": {"a\nb": 1e3}}, "pumped_arm")
    assert len(str(error).splitlines()) == len(error.faults)
    assert "a\\nb" in str(error)


def test_a_list_that_is_too_short_is_told_once_its_entries_are_right() -> None:
    robot: dict[str, Any] = {
        "name": "tube", "source": "made up", "base": ["base"],
        "body": {"kind": "mesh", "file": "tube.obj", "set": [{"name": "base", "line": "side"}]},
    }  # fmt: skip
    assert dict(refusal({"soft_robot": robot}).faults)["soft_robot.body.set.base.line"].startswith(
        "unknown key"
    )
    robot["body"]["set"] = [{"name": "base", "group": "side"}]
    assert "needs at least 2" in dict(refusal({"soft_robot": robot}).faults)["soft_robot.body.set"]


def test_groups_of_one_name_are_refused() -> None:
    film = {"young_modulus_Pa": 1e9, "poisson_ratio": 0.3, "thickness_m": 1e-4}
    ends = [{"name": name, "axis": "z", "at_m": at_m} for name, at_m in (("base", 0.0), ("tip", 0.1))]
    robot = {
        "name": "tube", "source": "made up", "base": ["base"], "film": film,
        "body": {"kind": "mesh", "file": "tube.obj", "set": ends},
        "group": [{"name": "wall", "film": film}, {"name": "wall", "film": film}],
    }  # fmt: skip
    with pytest.raises(ScenarioError) as caught:
        load_scenario("ur5e_hexagon_arm", {"soft_robot": robot})
    assert dict(caught.value.faults)["soft_robot.group.wall"] == "the name is used twice; names must differ"


FABRIC = {"modulus_warp_Pa": 0.5e9, "modulus_weft_Pa": 2e9, "shear_modulus_Pa": 5e7}
WRONG_FABRICS: dict[str, tuple[dict[str, Any], dict[str, Any], str, str]] = {
    "no modulus": ({}, {}, "young_modulus_Pa", "neither is given"),
    "weft contracts too much": ({"poisson_ratio": 0.5}, FABRIC, "poisson_ratio", "below 0.5, the root"),
    "panels": ({"law": "wrinkling"}, FABRIC, "law", "of fabric it is 'plain' or 'tension_field'"),
    "direction": ({}, {**FABRIC, "warp_direction": [0.0, 0.0, 0.0]}, "fabric.warp_direction", "no length"),
    "softer": (
        {}, {**FABRIC, "straight_modulus_weft_Pa": 1e9}, "fabric.straight_modulus_weft_Pa", "2e+09, at least",
    ),
    "rubber": (
        {"law": "neo_hookean", "young_modulus_Pa": 1e6}, {}, "poisson_ratio", "is incompressible: give 0.5",
    ),
    "shear": ({}, {**FABRIC, "shear_modulus_Pa": 0.0}, "fabric.shear_modulus_Pa", "above 0"),
    "limp film": ({"young_modulus_Pa": 0.0035}, {}, "young_modulus_Pa", "at least 5000 with thickness_m"),
    "limp weft": (
        {"poisson_ratio": 0.0}, {**FABRIC, "modulus_weft_Pa": 4e3}, "fabric.modulus_weft_Pa", "at least 5000",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_FABRICS)
def test_wrong_fabrics_are_refused_by_key(case: str) -> None:
    changes, fabric, key, message = WRONG_FABRICS[case]
    film: dict[str, Any] = {"poisson_ratio": 0.3, "thickness_m": 2e-4, **changes}
    film |= {"fabric": fabric} if fabric else {}
    ends = [{"name": name, "axis": "z", "at_m": at_m} for name, at_m in (("base", 0.0), ("tip", 0.1))]
    robot = {
        "name": "tube", "source": "made up", "base": ["base"], "film": film,
        "body": {"kind": "mesh", "file": "tube.obj", "set": ends},
    }  # fmt: skip
    with pytest.raises(ScenarioError) as caught:
        load_scenario("ur5e_hexagon_arm", {"soft_robot": robot})
    assert message in dict(caught.value.faults)[f"soft_robot.film.{key}"]


def test_the_least_modulus_as_told_is_accepted() -> None:
    changes = {"soft_robot.film.thickness_m": 3e-4, "soft_robot.film.young_modulus_Pa": 1.3}
    with pytest.raises(ScenarioError) as caught:
        load_scenario("ur5e_hexagon_arm", changes)
    told = dict(caught.value.faults)["soft_robot.film.young_modulus_Pa"]
    least = float(told.partition("must be at least ")[2].split()[0])
    load_scenario("ur5e_hexagon_arm", {**changes, "soft_robot.film.young_modulus_Pa": least})
