"""The reference scenario on real physics, shortened: both modes, phase ends, targets, refusals."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.build.simulation import build
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

REFERENCE = "ur5e_hexagon_arm"
PHASES = ("hang", "inflate", "turn", "lift", "reach")
FEWER = {f"phase.{name}.increments": count for name, count in zip(PHASES, (1, 12, 12, 15, 8), strict=True)}
SHORTER: dict[str, Any] = {
    f"phase.{name}.duration_s": seconds
    for name, seconds in zip(PHASES, (0.02, 0.3, 0.4, 0.3, 0.3), strict=True)
} | {f"phase.{name}.settle_s": 0.02 for name in PHASES}


@cache
def run(mode: str) -> tuple[RunInfo, tuple[Snapshot, ...]]:
    """Return stage and snapshots of the shortened run."""
    simulation = build(
        load_scenario(
            REFERENCE,
            {"model.published": True, "mode": mode, **(FEWER if mode == "quasistatic" else SHORTER)},
        )
    )
    return simulation.stage, tuple(simulation.steps())


def ends(mode: str) -> dict[str, Snapshot]:
    """Return the last snapshot of each phase."""
    stage, snapshots = run(mode)
    return {stage.phase_names[snapshot.phase]: snapshot for snapshot in snapshots}


@pytest.mark.parametrize("mode", ["quasistatic", "dynamic"])
def test_snapshots_are_complete_finite_and_in_order(mode: str) -> None:
    stage, snapshots = run(mode)
    assert stage.mode == mode
    assert stage.phase_names == PHASES
    assert [snapshot.tick for snapshot in snapshots] == list(range(stage.ticks + 1))
    times = [snapshot.time_s for snapshot in snapshots]
    assert (np.diff(times) > 0.0).all()
    assert times[-1] == pytest.approx(stage.duration_s)
    if mode == "dynamic":
        assert times == [tick * stage.tick_s for tick in range(stage.ticks + 1)]
    assert (np.diff([snapshot.phase for snapshot in snapshots[1:]]) >= 0).all()
    for snapshot in snapshots:
        for value in (snapshot.node_position, snapshot.joint_position, snapshot.body_position,
                      snapshot.wrench.force, snapshot.wrench.torque, snapshot.sag_m,
                      snapshot.power_error_W):  # fmt: skip
            assert np.isfinite(value).all()
    # arrays are the snapshot's own: none is a later one's
    nodes = [snapshot.node_position for snapshot in snapshots[-3:]]
    assert not any(np.shares_memory(a, b) for a, b in pairwise(nodes))


@pytest.mark.parametrize("mode", ["quasistatic", "dynamic"])
def test_phases_end_with_the_loads_they_name(mode: str) -> None:
    end = ends(mode)
    assert [end[name].pressure_Pa for name in PHASES] == [0.0, 30e3, 30e3, 30e3, 30e3]
    assert end["turn"].cable_tension_N.tolist() == [0.0, 0.0]
    assert (end["lift"].cable_tension_N > 1.0).all()
    assert (end["reach"].cable_tension_N == end["lift"].cable_tension_N).all()
    axis = end["turn"].world_from_flange.rotation[:, 2]
    bound = 1e-6 if mode == "quasistatic" else 0.05
    assert axis == pytest.approx([np.sin(0.28 * np.pi), 0.0, -np.cos(0.28 * np.pi)], abs=bound)


def test_quasistatic_equilibria() -> None:
    _, snapshots = run("quasistatic")
    assert max(snapshot.residual_N for snapshot in snapshots) < 1e-6
    weight = run("quasistatic")[0].soft_weight_N
    assert weight == pytest.approx(8.52)
    for snapshot in snapshots:
        # payload compensation: the arm stands where it was told to, whatever hangs on it
        assert snapshot.joint_position == pytest.approx(snapshot.joint_target, abs=1e-8)
        assert snapshot.wrench.force == pytest.approx([0.0, 0.0, -weight], abs=1e-6 * weight)


def test_few_increments_lead_to_the_same_phase_ends() -> None:
    # of 380 increments, as measured
    end = ends("quasistatic")
    assert end["inflate"].tip_position == pytest.approx([0.3, 0.0, 0.51329], abs=2e-5)
    assert end["turn"].tip_position == pytest.approx([0.36245, 0.0, 0.52924], abs=2e-5)
    assert end["turn"].tip_direction == pytest.approx([0.18141, 0.0, -0.98341], abs=2e-5)
    assert end["turn"].sag_m == pytest.approx(0.09595, abs=2e-5)
    assert end["inflate"].sag_m == pytest.approx(0.0, abs=1e-9)


def test_quasistatic_targets_are_met() -> None:
    scenario, end = load_scenario(REFERENCE), ends("quasistatic")
    for phase in scenario.phases:
        snapshot, target = end[phase.name], phase.tip_target
        if target is None:
            assert snapshot.tip_target is None
            continue
        assert snapshot.tip_target is not None
        free = np.isnan(snapshot.tip_target)
        miss = np.where(free, 0.0, snapshot.tip_position - snapshot.tip_target)
        assert np.linalg.norm(miss) < 1e-4
        if target.direction is not None:
            wanted = np.array(target.direction) / np.linalg.norm(target.direction)
            angle = np.arctan2(
                np.linalg.norm(np.cross(snapshot.tip_direction, wanted)), snapshot.tip_direction @ wanted
            )
            assert np.degrees(angle) < 0.1
    assert end["lift"].tip_position[2] > end["turn"].tip_position[2] + 0.01


def test_dynamic_run_follows_the_quasistatic_one() -> None:
    # hurried, so the arm still swings: near, not equal
    still, moving = ends("quasistatic"), ends("dynamic")
    for name in PHASES:
        gap = moving[name].world_from_flange.translation - still[name].world_from_flange.translation
        assert np.linalg.norm(gap) < 0.02, name
        assert np.linalg.norm(moving[name].tip_position - still[name].tip_position) < 0.1, name
    assert moving["hang"].tip_position == pytest.approx(still["hang"].tip_position, abs=1e-6)
    _, snapshots = run("dynamic")
    assert max(snapshot.residual_N for snapshot in snapshots) < 0.1
    assert any(np.linalg.norm(snapshot.wrench.force[:2]) > 0.5 for snapshot in snapshots)


def power_errors(tick_s: float) -> Iterator[float]:
    """Yield the ledger's power error over a smooth turn of the inflated arm."""
    turn = {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.28 * np.pi}
    changes = {
        "mode": "dynamic",
        "clock.tick_s": tick_s,
        "start.pressure_Pa": 30e3,
        "phase": [
            {"name": "hang", "duration_s": 0.04},
            {"name": "turn", "duration_s": 0.6, "flange_turn": turn},
        ],
    }
    for snapshot in build(load_scenario(REFERENCE, changes)).steps():
        yield abs(snapshot.power_error_W)


def test_power_lost_at_the_interface_is_of_first_order_in_the_tick() -> None:
    # the flange receives the wrench of the tick before
    coarse, fine = max(power_errors(0.004)), max(power_errors(0.002))
    assert coarse / fine == pytest.approx(2.0, abs=0.4)
    assert 1e-5 < fine < 0.2


@pytest.mark.parametrize("mode", ["quasistatic", "dynamic"])
def test_without_payload_compensation_the_arm_droops(mode: str) -> None:
    changes = {
        "mode": mode,
        "payload_compensation": False,
        "start.pressure_Pa": 30e3,
        "phase": [{"name": "hang", "duration_s": 0.4, "increments": 1}],
    }
    heights = {}
    for compensated in (False, True):
        scenario = load_scenario(REFERENCE, changes | {"payload_compensation": compensated})
        for snapshot in build(scenario).steps():
            heights[compensated] = snapshot.world_from_flange.translation[2]
    assert heights[True] == pytest.approx(0.7, abs=1e-6)
    assert 1e-5 < 0.7 - heights[False] < 0.01


# the command's way of saying no: exit code 2, the key named, nothing written
REFUSED = {
    "tip target out of reach": ("phase.reach.tip_target.position_m=[3.0, 0.0, 0.5]", "phase.reach"),
    "start out of reach": ("start.flange.position_m=[1.5, 0.0, 0.7]", "start.flange"),
    "height that no tension reaches": ("phase.lift.tip_target.height_m=2.0", "phase.lift.tip_target"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_reached_is_refused_before_anything_is_written(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assignment, key = REFUSED[name]
    out = tmp_path / "out"
    words = ["--set", assignment, "--set", "model.published=true", "--out", str(out), "--no-recording"]
    assert main(["run", REFERENCE, *words]) == 2
    assert not out.exists()
    message = capsys.readouterr().err
    assert key in message
    assert "Traceback" not in message


def test_the_command_writes_the_summary_of_a_real_run(tmp_path: Path) -> None:
    words = [word for key, value in FEWER.items() for word in ("--set", f"{key}={value}")]
    out = tmp_path / "out"
    words += ["--set", "mode=quasistatic", "--set", "model.published=true", "--quiet", "--no-recording"]
    assert main(["run", REFERENCE, *words, "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["status"] == "completed"
    assert summary["ticks"] == sum(FEWER.values())
    assert summary["max_equilibrium_residual_N"] < 1e-6
    reach = summary["phases"][-1]
    assert reach["name"] == "reach"
    assert reach["tip_error_m"] < 1e-4
    _, snapshots = run("quasistatic")
    assert summary["newton_iterations"] == sum(s.newton_iterations for s in snapshots)
    assert reach["tip_position_m"] == pytest.approx(snapshots[-1].tip_position.tolist(), abs=1e-9)
