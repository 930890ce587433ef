"""The fidelity switch: what stands for the soft robot in a run, in both modes."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.options import fidelity_body
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.errors import ScenarioError

SCENARIO = """
schema = 2
title = "Two units on a UR5e"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [] }
model.published = true
solver = { damping_per_s = 2.0 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 30e3

[[phase]]
name = "turn"
duration_s = 0.2
settle_s = 0.1
increments = 3
pressure_Pa = 20e3
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.3 }
"""
TARGET = {"position_m": [0.42, 0.0, 0.41], "reach_with": "flange"}


@cache
def run(folder: Path, fidelity: str, mode: str) -> cosim.RunResult:
    """Return the run of the scenario at a fidelity."""
    return cosim.run(scenario_file(folder), overrides={"fidelity": fidelity, "mode": mode})


def scenario_file(folder: Path) -> Path:
    path = folder / "two_units.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fidelity")


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_a_rigid_tip_moves_with_the_flange(folder: Path, mode: str) -> None:
    rigid, lumped = run(folder, "rigid", mode), run(folder, "lumped", mode)
    assert rigid.tip_position[0] == pytest.approx(lumped.tip_position[0], abs=1e-9)  # the shape of the start
    offset = rigid.tip_position - rigid.flange_position
    assert np.linalg.norm(offset, axis=1) == pytest.approx(np.linalg.norm(offset[0]), abs=1e-12)
    assert np.abs(rigid.tip_position[-1] - lumped.tip_position[-1]).max() > 1e-3
    assert rigid.summary["newton_iterations"] == 0
    weight = lumped.summary["soft_weight_N"]
    assert rigid.flange_force[-1] == pytest.approx([0.0, 0.0, -weight], abs=0.03 * weight)
    assert "rigid: the shape of the start is kept" in rigid.stage.report


def test_the_arm_droops_alike_under_either(folder: Path) -> None:
    rigid, lumped = run(folder, "rigid", "quasistatic"), run(folder, "lumped", "quasistatic")
    assert rigid.flange_position[0] == pytest.approx(lumped.flange_position[0], abs=1e-7)


def test_refined_divides_every_triangle(folder: Path) -> None:
    scenario = load_scenario(scenario_file(folder))
    finer = load_scenario(scenario, {"fidelity": "refined"})
    by_hand = load_scenario(scenario, {"soft_robot.stack.refine": 1})
    assert len(fidelity_body(finer).triangles) == 4 * len(fidelity_body(scenario).triangles)
    assert (fidelity_body(finer).hinges.stiffness == fidelity_body(by_hand).hinges.stiffness).all()
    assert finer.soft_robot == scenario.soft_robot  # the file of the run says what was asked for


def test_targets_of_a_rigid_robot_are_planned_on_the_lumped_one(folder: Path) -> None:
    reach = {"name": "reach", "duration_s": 0.2, "increments": 2, "tip_target": TARGET}
    changes: dict[str, Any] = {"mode": "quasistatic", "phase": [reach]}
    runs = [
        cosim.run(scenario_file(folder), overrides={**changes, "fidelity": f}) for f in ("lumped", "rigid")
    ]
    assert runs[0].flange_position[-1] == pytest.approx(runs[1].flange_position[-1], abs=1e-6)
    assert "the targets of reach are planned on the lumped model" in runs[1].stage.report


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fidelity": "rigid", "model.closed": False}, "fidelity: 'rigid' needs model.closed"),
        ({"fidelity": "rigid", "phase.turn.release": ["unit_1.hole"], "phase.turn.clamp": ["tip"]},
         "phase.turn.release: cannot be combined with fidelity = 'rigid'"),
        ({"fidelity": "refined", "soft_robot.stack.refine": 4}, "fidelity: 'refined' is one refinement"),
        ({"fidelity": "fine"}, "fidelity: got the text 'fine'; allowed: 'rigid', 'section', 'lumped', "),
    ],
)  # fmt: skip
def test_what_a_fidelity_leaves_out_is_refused(folder: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load_scenario(scenario_file(folder), changes)


def test_the_switch_is_of_the_command_line_too(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--set", "fidelity=rigid", "--set", "model.closed=false"]
    assert main(["run", str(scenario_file(folder)), "--out", str(tmp_path / "out"), *words]) == 2
    assert "fidelity" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
