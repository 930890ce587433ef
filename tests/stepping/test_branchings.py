"""A symmetric pouch gives way to one side; runs say so, whichever way they were asked for.

The pouch of `tests/cases/saddle` is straight up to 7.86 kPa, where its tangent stiffness was found to become
singular by factorisations in steps of 10 Pa. Beyond, it leans to a side, at 10 kPa by 85 mm.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import cosim
from benchmarks.atlas.symmetric import symmetric_bodies
from cosim.cli.main import main

CASE = Path(__file__).parents[1] / "cases" / "saddle" / "pouch_on_ur5e.toml"
STATICS = ("--set", "mode=quasistatic", "--set", "robot=none")
BRANCHES_Pa, ASIDE_m = 7860.0, 0.085


def pouch(**changes: Any) -> cosim.RunResult:
    """Return a run of the pouch, held by its seam at a place; keys have __ in place of dots."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return cosim.run(CASE, overrides={"robot": "none"} | keys)


def in_statics(increments: int, **changes: Any) -> cosim.RunResult:
    """Return a static run of the pouch."""
    return pouch(mode="quasistatic", phase__inflate__increments=increments, **changes)


def large(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the branchings in which more than a wrinkle moves."""
    return [row for row in summary["branchings"] if row["extent"] > 0.2 and not row["snap"]]


@pytest.mark.parametrize("increments", [10, pytest.param(1000, marks=pytest.mark.long)])
def test_a_saddle_is_left_and_named_whatever_the_increments(increments: int) -> None:
    summary = in_statics(increments).summary
    (found,) = large(summary)
    assert found["phase"] == "inflate"
    assert found["pressure_Pa"] == pytest.approx([BRANCHES_Pa], rel=0.01)
    assert found["load_factor"] == pytest.approx(BRANCHES_Pa / 10e3, rel=0.01)
    assert found["place"].endswith("of tip")
    assert found["direction"] == pytest.approx([0.0, 1.0, 0.0], abs=0.05)
    # the sides mirror one another, but for wrinkles
    mirrored = [found["other_tip_m"][0], -found["other_tip_m"][1], found["other_tip_m"][2]]
    assert mirrored == pytest.approx(found["tip_m"], abs=1e-3)
    assert abs(found["tip_m"][1]) > 0.02
    assert abs(summary["phases"][-1]["tip_position_m"][1]) == pytest.approx(ASIDE_m, abs=1e-3)
    # it leans by 33 mm at first; folded further it has less energy
    (snap,) = (row for row in summary["branchings"] if row["snap"] and row["load_factor"] > 0.78)
    assert abs(snap["other_tip_m"][1]) == pytest.approx(0.033, abs=2e-3)
    assert abs(snap["tip_m"][1]) > 0.08
    assert summary["phases"][-1]["stability"] == "after a snap"
    (line,) = (line for line in summary["phases"][-1]["branchings"] if "branches at" in line)
    assert "of tip moves along (0, 1, 0) or against it" in line
    assert "on the other side it is at" in line


def test_the_unstable_branch_is_followed_on_purpose() -> None:
    summary = in_statics(20, solver__follow_unstable=True).summary
    (found,) = large(summary)
    assert found["pressure_Pa"] == pytest.approx([BRANCHES_Pa], rel=0.01)
    assert "solver.follow_unstable" in found["chosen"]
    assert found["other_tip_m"] is None
    # straight: what rounding makes of it in four increments stays far below a millimetre
    assert abs(summary["phases"][-1]["tip_position_m"][1]) < 1e-3


@pytest.mark.long
def test_a_load_to_one_side_decides() -> None:
    lean = {"gravity_m_s2": [0.0, -0.5, -9.81]}
    found = in_statics(20, **lean).summary["phases"][-1]["tip_position_m"]
    assert found[1] == pytest.approx(-ASIDE_m, abs=5e-3)


def test_what_stays_below_its_branching_is_stable() -> None:
    summary = in_statics(10, phase__inflate__pressure_Pa=6e3).summary
    assert large(summary) == []
    assert 1.0 < summary["phases"][-1]["lowest_frequency_Hz"] < 100.0
    assert summary["phases"][-1]["stability"] == "stable"


def test_a_phase_that_ends_near_its_branching_says_so(caplog: pytest.LogCaptureFixture) -> None:
    phase = in_statics(10, phase__inflate__pressure_Pa=7.8e3).summary["phases"][-1]
    assert "phase 'inflate' ends near a branching" in caplog.text
    assert phase["stability"] == "near a branching"
    assert 7.8e3 * (1.0 + phase["load_margin"]) == pytest.approx(BRANCHES_Pa, rel=5e-3)


@pytest.mark.long
def test_in_time_its_position_at_rest_is_reported() -> None:
    # Without a load to one side it may stay unstable for 8 s: rounding alone decides when it leaves.
    # This one is a ten thousandth of its weight: far above rounding, and too little to decide beforehand.
    aside = [0.0, -1e-3, -9.81]
    summary = pouch(clock__tick_s=0.002, phase__inflate__settle_s=8.0, gravity_m_s2=aside).summary
    (found,) = large(summary)
    # rounding decides on the place, and some places are near neutral; but it is aside
    assert summary["phases"][-1]["stability"] in ("after a branching", "near neutral")
    assert abs(found["tip_m"][1]) > 0.01
    (warning,) = (text for text in summary["warnings"] if "rounding" in text)
    assert "comes to rest with its tip at" in warning


@pytest.mark.parametrize("tick_s", [pytest.param(0.001, marks=pytest.mark.long), 0.004])
def test_a_run_in_time_says_that_nothing_decided_on_its_side(tick_s: float) -> None:
    # at its end it may be straight still, on its way, or swing through: where it would stay is told as well
    summary = pouch(clock__tick_s=tick_s).summary
    found = max(large(summary), key=lambda row: row["pressure_Pa"][0])
    assert BRANCHES_Pa < found["pressure_Pa"][0] <= 10e3
    assert found["place"].endswith("of tip")
    assert abs(found["direction"][1]) > 0.9
    assert abs(found["tip_m"][1]) > 0.01
    warning = [text for text in summary["warnings"] if "rounding" in text][-1]
    assert "'inflate'" in warning
    assert "comes to rest with its tip at" in warning


def test_a_small_snap_is_named_as_well() -> None:
    # hardly inflated, its tip goes aside by 8 mm at once: a thirtieth of its length
    summary = in_statics(50, phase__inflate__pressure_Pa=500.0).summary
    (snap,) = (row for row in summary["branchings"] if row["snap"])
    assert 370.0 < snap["pressure_Pa"][0] < 380.0
    before, after = (abs(snap[key][1]) for key in ("other_tip_m", "tip_m"))
    assert before < 0.002 < 0.006 < after


@pytest.mark.parametrize("together", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_branching_between_two_checks_of_a_slow_ramp_is_reported(together: bool) -> None:
    # it is straight at 75 % of its ramp, and at rest aside at its end
    keys = {"robot": "none", "clock.tick_s": 0.004, "phase.inflate.duration_s": 6.0}
    if together:
        rows = large(cosim.run(CASE, overrides=keys).summary)
        pressures = [row["pressure_Pa"][0] for row in rows if abs(row["direction"][1]) > 0.9]
        assert all("rounding" in row["chosen"] for row in rows)
    else:
        simulation, pressures = cosim.Simulation(CASE, overrides=keys), []
        while simulation.ticks_left and not pressures:
            found = simulation.step().branchings
            pressures = [each.pressure_Pa[0] for each in found if abs(each.direction[1]) > 0.9]
    # seen once it moves, at a pressure that has grown by some percent meanwhile
    assert BRANCHES_Pa < pressures[0] < 1.06 * BRANCHES_Pa


def test_a_run_in_time_below_its_branching_warns_of_nothing() -> None:
    assert pouch(clock__tick_s=0.004, phase__inflate__pressure_Pa=6e3).summary["branchings"] == []


def test_it_is_on_screen(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(["run", str(CASE), "--out", str(out), "--no-recording", *STATICS]) == 0
    assert "stability: phase 'inflate' branches at 7.8" in capfd.readouterr().err
    (found,) = large(json.loads((out / "summary.json").read_text("utf-8")))
    assert found["other_tip_m"] is not None


def test_a_sample_of_symmetric_bodies_ends_stable_and_says_where_they_branch() -> None:
    """All fourteen: `python benchmarks/stability.py --symmetric`."""
    bodies = list(symmetric_bodies())
    assert len(bodies) == 14
    assert sum(body.drawn for body in bodies) >= 4
    for body in (bodies[3], bodies[6]):  # a pouch, a stack
        assert body.run().good, body.name


def test_of_open_ends_it_is_said_that_it_is_not_known(caplog: pytest.LogCaptureFixture) -> None:
    # without the pull of its caps, a stack under pressure is a column
    summary = cosim.run("paper_figure_9").summary
    for phase in summary["phases"]:
        assert (phase["stability"], phase["losses_held"]) == ("undetermined", True)
        assert f"phase '{phase['name']}' may end unstable: its loads have no potential" in caplog.text
    assert summary["warnings"] == summary["branchings"] == []
