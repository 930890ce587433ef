"""An arm beyond its limits is reported; one that cannot stand where it starts is refused."""

from __future__ import annotations

import json
from pathlib import Path
from traceback import format_exception
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.arms import find_arm
from cosim.cli.main import EXIT_DONE, EXIT_INPUT, main

SMALL = '{ file = "hexagon_arm", stack = { units = 3 }, cable = []'
TABLE = """
[[object]]
name = "table"
shape = "box"
size_m = [0.2, 0.4, 0.2]
position_m = [0.15, 0.0, 0.6]
"""


def scenario(
    folder: Path,
    *,
    start: str = "[0.3, 0.0, 0.7]",
    shift: str = "[0.0, 0.0, -0.05]",
    duration_s: float = 0.5,
    more: str = "",
    node_mass: str = "",
) -> Path:
    """Write a scenario in which a UR5e moves a rigid soft robot for one phase."""
    path = folder / "arm.toml"
    path.write_text(
        f"""
schema = 2
title = "An arm"
robot = "ur5e"
soft_robot = {SMALL}{node_mass} }}
model.published = true
fidelity = "rigid"

[start]
flange = {{ position_m = {start}, direction = [0.0, 0.0, -1.0] }}
{more}
[[phase]]
name = "move"
duration_s = {duration_s}
increments = 10
flange_shift_m = {shift}
""",
        encoding="utf-8",
    )
    return path


def heavy(folder: Path) -> Path:
    """Write a scenario in which a robot of 20 kg is reached out."""
    nodes = 3 * 42 + 6
    return scenario(
        folder, start="[0.3, 0.0, 0.5]", shift="[0.42, 0.0, 0.0]", duration_s=1.0,
        node_mass=f", mass = {{ node_mass_kg = {20.0 / nodes} }}",
    )  # fmt: skip


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_an_arm_that_starts_in_a_table_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], mode: str
) -> None:
    everywhere = TABLE.replace("0.2, 0.4, 0.2", "0.6, 0.6, 0.6")  # the arm reaches around a small one
    path, out = scenario(tmp_path, more=everywhere), tmp_path / "out"
    code = main(["run", str(path), "--set", f"mode={mode}", "--out", str(out), "--no-recording"])
    said = capsys.readouterr().err
    assert code == EXIT_INPUT
    assert not out.exists()
    assert "start.flange: the arm overlaps something: upper_arm_link" in said
    assert ", forearm_link" in said
    assert "mm deep in table" in said


def test_an_arm_that_reaches_around_a_table_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = scenario(tmp_path, more=TABLE, shift="[0.0, 0.0, 0.0]"), tmp_path / "out"
    code = main(["run", str(path), "--set", "mode=quasistatic", "--out", str(out), "--no-recording"])
    said = capsys.readouterr().err
    assert code == EXIT_DONE
    assert "\nwarning: planned: the arm begins in another configuration; in the one nearest" in said
    assert "forearm_link" in said.partition("nearest to its home, ")[2].partition("mm deep in table")[0]
    free = cosim.Simulation(path, overrides={"object.table.position_m": [0.15, 0.0, 5.0]})
    assert free.stage.arm is not None
    assert not free.stage.arm.avoided


def test_a_base_that_starts_in_the_floor_is_refused() -> None:
    with pytest.raises(cosim.ScenarioError, match=r"start\.flange: .*base stands 0\.70 mm deep in floor"):
        cosim.run("paper_figure_9", overrides={"start.flange.position_m": [0.3, 0.0, -0.0007]})


def test_a_soft_robot_that_begins_inside_an_object_is_named(tmp_path: Path) -> None:
    block = """
[[object]]
name = "block"
shape = "box"
size_m = [0.2, 0.2, 0.1]
position_m = [0.3, 0.0, 0.6]
mass_kg = 0.1
"""
    path = scenario(tmp_path, more=block)
    overrides = {"fidelity": "lumped", "start.pressure_Pa": 20e3}
    with pytest.raises(cosim.InstabilityError, match=r"at the start: .* begins \d+\.\d mm deep in 'block'"):
        cosim.Simulation(path, overrides=overrides)
    found = cosim.Simulation(path, overrides={**overrides, "object.block.position_m": [0.3, 0.0, 0.4]})
    assert found.snapshot.time_s == 0.0


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_an_arm_that_cannot_hold_itself_at_its_start_is_refused(tmp_path: Path, mode: str) -> None:
    overrides = {"gravity_m_s2": [0.0, 0.0, -100.0], "mode": mode}
    with pytest.raises(cosim.ScenarioError, match=r"start\.flange: .*elbow_joint \d+ of 150 N m"):
        cosim.run(scenario(tmp_path), overrides=overrides)


def test_an_arm_that_collapses_does_not_just_complete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    code = main(["run", str(heavy(tmp_path)), "--out", str(out), "--no-recording"])
    said, summary = capsys.readouterr().err, json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert code == EXIT_DONE
    warnings = summary["warnings"]
    # those of the plan before the run, then the worst of the run and the count
    assert all(f"warning: {line}" in said for line in warnings if line.startswith("planned: "))
    own = next(line for line in warnings if not line.startswith("planned: "))
    assert f"warnings:  {len(warnings)}, all in the summary; {own}" in said
    assert any(line.startswith("planned: torque of shoulder_lift_joint") for line in warnings)
    assert any(
        line.startswith("the arm did not hold: shoulder_lift_joint was at its limit of") for line in warnings
    )
    run = summary["arm"]["run"]
    assert run["tracking_error"]["beyond"]
    assert run["saturated_s"]["shoulder_lift_joint"] > 0.1
    assert abs(run["torque"]["value"]) == pytest.approx(run["torque"]["bound"])


def test_in_statics_a_joint_without_strength_ends_the_run_and_was_foreseen(tmp_path: Path) -> None:
    with pytest.raises(cosim.SolverError, match="joint shoulder_lift_joint") as failure:
        cosim.run(heavy(tmp_path), overrides={"mode": "quasistatic"})
    result = failure.value.result
    assert result is not None
    planned = result.summary["arm"]["planned"]
    assert planned["velocity"] is planned["acceleration"] is None
    assert planned["torque"]["beyond"]
    # both are of a rigid payload at rest, droop aside: the last increment that was held is the bound's
    assert abs(result.summary["arm"]["run"]["torque"]["value"]) < 150.0 < abs(planned["torque"]["value"])


def test_a_motion_that_is_too_fast_is_reported_before_and_after(tmp_path: Path) -> None:
    path = scenario(tmp_path, shift="[0.2, 0.2, -0.1]", duration_s=0.08)
    result = cosim.run(path)
    planned, run = result.summary["arm"]["planned"], result.summary["arm"]["run"]
    asked = np.abs(np.diff(result.joint_target, axis=0)).max() / 0.002
    # the largest speed is between two ticks of 25 in the ramp, and 50 samples: a parabola's top to a percent
    assert abs(planned["velocity"]["value"]) == pytest.approx(asked, rel=0.02)
    assert planned["velocity"]["bound"] == pytest.approx(np.pi)
    assert planned["acceleration"]["bound"] == pytest.approx(np.deg2rad(800.0))
    for section in (planned, run):
        assert section["velocity"]["beyond"]
        assert section["acceleration"]["beyond"]
        assert section["velocity"]["phase"] == "move"
    error = np.abs(result.joint_position[:-1] - result.joint_target[1:]).max()
    assert abs(run["tracking_error"]["value"]) == pytest.approx(error)
    speed = np.abs(result.joint_velocity).max()
    assert abs(run["velocity"]["value"]) == pytest.approx(speed)


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_a_link_that_is_driven_into_a_table_is_named(tmp_path: Path, mode: str) -> None:
    """The elbow comes down on a table beside the soft robot, which is not near it."""
    table = TABLE.replace("0.15, 0.0, 0.6", "0.05, 0.0, 0.57").replace("0.2, 0.4, 0.2", "0.06, 0.4, 0.06")
    path = scenario(tmp_path, shift="[0.1, 0.0, -0.25]", duration_s=1.0, more=table)
    result = cosim.run(path, overrides={"mode": mode})
    for section in (result.summary["arm"]["planned"], result.summary["arm"]["run"]):
        touches = {(touch["link"], touch["other"]): touch for touch in section["contacts"]}
        touch = touches["forearm_link", "table"]
        assert 0.0 < touch["first_s"] <= 1.0
        assert touch["depth_m"] > 0.0
    assert any("forearm_link touches table from" in line for line in result.summary["warnings"])


def test_an_arm_thrown_out_of_an_object_is_one_error_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Starts in objects are refused; here they are let pass, as an arm may get into one later on."""
    monkeypatch.setattr("cosim.plan.start_checks.check_start", lambda *_: None)
    monkeypatch.setattr("cosim.build.simulation.check_base", lambda *_: None)
    monkeypatch.setattr("cosim.rigid.scene.coupled_scene.CoupledScene.begins_in", lambda *_: "")
    table = TABLE.replace("0.2, 0.4, 0.2", "0.6, 0.6, 0.6")
    with pytest.raises(cosim.SolverError, match=r"tick 1 .*with .*forearm_link in table") as failure:
        cosim.run(scenario(tmp_path, more=table), overrides={"fidelity": "lumped"})
    assert "".join(format_exception(failure.value)).count("Traceback") == 1


def test_a_motion_within_the_limits_warns_of_nothing(tmp_path: Path) -> None:
    result = cosim.run(scenario(tmp_path))
    assert result.summary["warnings"] == []
    run: dict[str, Any] = result.summary["arm"]["run"]
    assert run["contacts"] == []
    assert not any(run["saturated_s"].values())


def test_a_reference_that_jumps_is_a_speed_within_one_tick(tmp_path: Path) -> None:
    path = scenario(tmp_path, shift="[0.02, 0.0, 0.0]", duration_s=0.2)
    smooth, step, linear = (
        cosim.Simulation(path, overrides={"phase.move.ramp": ramp}).stage.arm
        for ramp in ("smooth", "step", "linear")
    )
    assert smooth is not None
    assert step is not None
    assert linear is not None
    found = [{e.quantity: e for e in planned.extremes} for planned in (smooth, step, linear)]
    assert not found[0]["acceleration"].beyond
    assert found[1]["velocity"].beyond
    assert found[2]["acceleration"].beyond
    assert not found[2]["velocity"].beyond


def test_the_bound_of_acceleration_is_that_of_the_arms_file() -> None:
    assert find_arm("ur5e").acceleration_bound == pytest.approx(np.full(6, np.deg2rad(800.0)))
    assert find_arm("panda").acceleration_bound[1] == pytest.approx(7.5)
