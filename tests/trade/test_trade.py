"""`cosim trade`: candidates, errors against the reference, Pareto front, choice, files."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.build.simulation import build
from cosim.cli import trade as command
from cosim.cli.main import main
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch
from cosim.trade.candidates import Candidate, candidates_of
from cosim.trade.measuring import Curve, Measured, Telling, compared, measure, unfollowed, with_commands
from cosim.trade.report import (
    Requirement,
    as_json,
    choice_lines,
    draw,
    markdown,
    pareto_front,
    parse_budget,
    parse_force,
    parse_tolerance,
    pick,
)

REFERENCE = "ur5e_hexagon_arm"
PUBLISHED = {"model.published": True}
MADE_UP = [("fast", 8.0, 0.02), ("slow and bad", 1.0, 0.03), ("middle", 4.0, 0.005), ("good", 0.5, 0.001)]


def made_up() -> list[Measured]:
    """Return a reference and four candidates with given speeds and errors."""
    reference = Measured(
        Candidate("finest", "time", {}, reference=True), 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, reference=True
    )
    changes = {"clock.tick_s": 0.001, "phase.a.duration_s": 1.0}
    rows = [
        Measured(Candidate(f"{name}, 1 ms, 1 tangent", "time", changes),
                 factor, error, error, error, 10.0 * error, 0.3, 2.0)
        for name, factor, error in MADE_UP
    ]  # fmt: skip
    return [
        reference,
        *rows,
        Measured(Candidate("lost", "time", {}), failure="failed: ConvergenceError: no; at all"),
    ]


def names(results: list[Measured]) -> list[str]:
    return [result.candidate.name.split(",")[0] for result in results]


def small(**changes: Any) -> Scenario:
    """Return two units on a held base that are blown up fast."""
    return load_scenario(
        REFERENCE,
        {
            "robot": "none",
            "soft_robot": {"file": "hexagon_arm", "stack": {"units": 2}, "cable": []},
            "model.published": True,
            "start.cable_tension_N": [],
            "phase": [
                {"name": "inflate", "duration_s": 0.1, "pressure_Pa": 20e3},
                {"name": "rest", "duration_s": 0.04},
            ],
            **changes,
        },
    )


def test_the_front_leaves_out_what_is_beaten_twice() -> None:
    assert names(pareto_front(made_up())) == ["fast", "middle", "good"]


@pytest.mark.parametrize(
    ("requirement", "name"),
    [
        (Requirement(budget=1.0), "middle"),
        (Requirement(budget=8.0), "fast"),  # just met
        (Requirement(budget=5.0), "fast"),
        (Requirement(tolerance_m=0.006), "middle"),
        (Requirement(tolerance_m=0.5), "fast"),
        (Requirement(tolerance_m=0.001), "good"),
        (Requirement(tolerance_m=0.5, force_N=0.05), "middle"),
        (Requirement(budget=0.1, force_N=0.05), "good"),
    ],
)
def test_the_choice_meets_the_requirement(requirement: Requirement, name: str) -> None:
    found = pick(made_up(), requirement)
    assert found is not None
    assert names([found]) == [name]
    assert "--set clock.tick_s=0.001" in choice_lines(made_up(), requirement)
    assert "phase" not in choice_lines(made_up(), requirement)


def test_a_budget_is_met_with_a_reserve_where_that_is_possible() -> None:
    for budget, name in ((4.0, "fast"), (3.0, "middle"), (7.9, "fast")):
        found = pick(made_up(), Requirement(budget=budget))
        assert found is not None
        assert names([found]) == [name]


def test_a_tolerance_is_of_objects_as_well() -> None:
    reference, fast, _, middle, *_ = made_up()
    dropped = replace(middle, object_error_m=0.2)
    assert pick([reference, fast, dropped], Requirement(tolerance_m=0.006)) is None
    assert names(pareto_front([reference, fast, dropped])) == ["fast"]
    assert "| objects, largest [mm] |" in markdown("made up", [reference, dropped])
    assert "objects, largest" not in markdown("made up", [reference, fast])


@pytest.mark.parametrize(
    "requirement", [Requirement(budget=9.0), Requirement(tolerance_m=1e-5), Requirement(1.0, force_N=0.01)]
)
def test_a_requirement_may_be_out_of_reach(requirement: Requirement) -> None:
    assert pick(made_up(), requirement) is None
    assert choice_lines(made_up(), requirement).startswith("No candidate")


def test_words_of_requirements() -> None:
    assert parse_budget("1.5x") == 1.5
    assert parse_budget("2") == 2.0
    assert parse_force("0.1 N") == 0.1
    for text, metres in (("1mm", 1e-3), ("0.5 mm", 5e-4), ("3e-3", 3e-3), ("20 um", 2e-5), ("1 m", 1.0)):
        assert parse_tolerance(text) == pytest.approx(metres)
    for text in ("fast", "-1x", "0", "nan", "inf"):
        with pytest.raises(InputError, match="real-time factor"):
            parse_budget(text)
        with pytest.raises(InputError, match="length"):
            parse_tolerance(text)
        with pytest.raises(InputError, match="force"):
            parse_force(text)


def test_report_and_figures() -> None:
    table = markdown("made up", made_up())
    assert "| * | middle, 1 ms, 1 tangent | 4.00 | 5 | 5 | 5 | 0.05 | 0.3 | 2.00 |" in table
    assert "| ref | finest | 0.10 |" in table
    assert "failed: ConvergenceError: no |" in table
    document = json.loads(as_json("made up", made_up(), Requirement(budget=1.0)))
    assert document["choice"] == "middle, 1 ms, 1 tangent"
    assert [entry["pareto"] for entry in document["candidates"]] == [False, True, False, True, True, False]
    assert document["candidates"][-1]["tip_error_m"] is None


def test_the_plot_is_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw("made up", made_up(), tmp_path / "trade.png")
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")


def test_candidates_of_the_reference_scenario_all_load() -> None:
    scenario = load_scenario(REFERENCE, PUBLISHED)
    commanded = with_commands(scenario, build)
    for quick in (False, True):
        candidates = candidates_of(scenario, quick=quick, time_scale=0.5)
        assert len({candidate.name for candidate in candidates}) == len(candidates)
        assert candidates[0].reference
        assert candidates[0].changes["clock.tick_s"] < min(m.changes["clock.tick_s"] for m in candidates[1:])
        for candidate in candidates:
            changed = load_scenario(commanded if candidate.commanded else scenario, candidate.changes)
            seconds = [sum(p.duration_s + p.settle_s for p in run.phases) for run in (changed, scenario)]
            assert seconds[0] == pytest.approx(0.5 * seconds[1], abs=0.2)
            for phase in changed.phases:
                ticks = phase.duration_s / changed.clock.tick_s
                assert ticks == pytest.approx(round(ticks), abs=1e-6)
    groups = [candidate.group for candidate in candidates_of(scenario) if candidate.reference]
    assert groups == ["time", "model", "model", "model"]


def test_candidates_need_a_dynamic_run_and_a_positive_factor() -> None:
    with pytest.raises(InputError, match="quasistatic"):
        candidates_of(load_scenario(REFERENCE, {"mode": "quasistatic"}))
    with pytest.raises(InputError, match="time scale"):
        candidates_of(load_scenario(REFERENCE, PUBLISHED), time_scale=0.0)


def test_errors_shrink_with_the_tick_at_the_integrators_order() -> None:
    converged = {"solver.dynamic_newton_iterations": 50, "solver.dynamic_tolerance_N": 1e-8}
    candidates = [
        Candidate("finest", "time", {**converged, "clock.tick_s": 2.5e-4, "solver.integrator": "bdf2"}, True)
    ]
    for integrator in ("implicit_euler", "bdf2"):
        for tick in (0.002, 0.001):
            changes = {**converged, "clock.tick_s": tick, "solver.integrator": integrator}
            candidates.append(Candidate(f"{integrator} {tick}", "time", changes))
    told: list[Measured] = []
    # slow and damped, so that the errors are those of the motion and not of the film's vibrations
    phase = {"name": "inflate", "duration_s": 0.4, "pressure_Pa": 20e3}
    slow = small(**{"start.pressure_Pa": 10e3, "solver.damping_per_s": 60.0, "phase": [phase]})
    results = measure(slow, candidates, build, Telling(done=told.append))
    assert told == results
    assert results[0].tip_error_m == 0.0
    euler, half_euler, bdf2, half_bdf2 = results[1:]
    for name in ("tip_error_m", "tip_rms_m"):
        assert getattr(euler, name) / getattr(half_euler, name) == pytest.approx(2.0, abs=0.25)
        assert getattr(bdf2, name) / getattr(half_bdf2, name) == pytest.approx(4.0, abs=0.7)
        assert getattr(bdf2, name) < 0.5 * getattr(euler, name)
    assert euler.force_error_N / half_euler.force_error_N == pytest.approx(2.0, abs=0.25)
    assert bdf2.force_error_N < 0.1 * euler.force_error_N
    for result in results:
        assert result.real_time_factor > 0.0
        assert np.isfinite([result.tip_error_m, result.end_error_m, result.force_error_N]).all()
        assert result.tip_error_m >= result.tip_rms_m
    assert not results[0].comparable
    assert results[1].force_error_N > 1e-4


def test_a_candidate_that_fails_leaves_the_others() -> None:
    candidates = [
        Candidate("finest", "time", {"clock.tick_s": 0.005}, True),
        Candidate("impossible", "time", {"clock.tick_s": 0.01, "start.pressure_Pa": "high"}),
        Candidate("coarse", "time", {"clock.tick_s": 0.01}),
    ]
    results = measure(small(), candidates, build)
    assert [bool(result.failure) for result in results] == [False, True, False]
    assert "ScenarioError" in results[1].failure
    assert results[2].comparable


def test_a_candidate_that_is_too_slow_is_stopped_by_name() -> None:
    candidates = [
        Candidate("finest", "time", {"clock.tick_s": 0.005}, True),
        Candidate("coarse", "time", {"clock.tick_s": 0.01}),
    ]
    # no machine is that fast; a reference may be ten times slower, and is not stopped either
    results = measure(small(), candidates, build, slowest=1e9)
    assert [result.failure[:32] for result in results] == [
        "stopped: slower than x1e+08 real", "stopped: slower than x1e+09 real"
    ]  # fmt: skip
    assert "at 0.00 s, in 'inflate'" in results[0].failure
    table = markdown("made up", results)
    assert "| coarse | stopped: slower than x1e+09 real time" in table
    assert not any(result.failure for result in measure(small(), candidates, build, slowest=0.0))


def test_what_follows_a_run_sees_every_tick_and_ends_with_it() -> None:
    seen: list[int] = []

    @contextmanager
    def follow(_scenario: Scenario, stage: RunInfo) -> Iterator[Callable[[TickBatch], None]]:
        try:
            yield lambda batch: seen.extend(batch.tick.tolist())
        finally:
            seen.append(-stage.ticks)

    candidates = [Candidate("finest", "time", {"clock.tick_s": 0.02}, True)]
    measure(small(), candidates, build, follow=follow)
    assert seen == [*range(8), -7]
    seen.clear()
    measure(small(), candidates, build, follow=follow, slowest=1e9)
    assert seen == [0, -7]


def test_objects_that_can_move_are_compared() -> None:
    times, still = np.array([0.0, 1.0]), np.zeros((2, 3))
    moved = np.array([[[0.0, 0.0, 0.0]], [[0.0, 0.3, 0.4]]])
    there, here = (
        Curve(times, still, objects, still, np.zeros(2), (1,), 0.1, 1.0) for objects in (0.0 * moved, moved)
    )
    result = compared(Candidate("other", "time", {}), here, there)
    assert result.object_error_m == pytest.approx(0.5)
    assert result.tip_error_m == 0.0
    assert result.position_error_m == result.object_error_m
    without = Curve(times, still, np.zeros((2, 0, 3)), still, np.zeros(2), (1,), 0.1, 1.0)
    assert compared(Candidate("other", "time", {}), without, without).position_error_m == 0.0


def test_the_command_writes_table_figures_and_plot(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    made_up_build: Callable[..., Any],
) -> None:
    monkeypatch.setattr(command, "build_simulation", made_up_build())
    monkeypatch.setattr(command, "recorded", unfollowed)  # made-up snapshots are nothing to draw
    monkeypatch.setattr("cosim.trade.measuring.with_commands", lambda scenario, _build: scenario)  # no plan
    out = tmp_path / "out"
    assert main(["trade", REFERENCE, "--quick", "--out", str(out), "--budget", "1e-9x"]) == 0
    written = capsys.readouterr().out
    assert "Run it with: --set fidelity=" in written
    assert (out / "trade.md").read_text(encoding="utf-8") in written
    document = json.loads((out / "trade.json").read_text(encoding="utf-8"))
    assert document["scenario"] == REFERENCE
    assert len(document["candidates"]) == len(candidates_of(load_scenario(REFERENCE), quick=True))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # as where it is not installed
    assert main(["trade", REFERENCE, "--quick", "--out", str(tmp_path / "b"), "--budget", "1e12x"]) == 1
    captured = capsys.readouterr()
    assert "No candidate" in captured.out
    assert "need matplotlib" in captured.err
    assert not (tmp_path / "b" / "trade.png").exists()


@pytest.mark.parametrize("words", [["--budget", "fast"], ["--tolerance", "0"], ["--scale-time", "-1"]])
def test_wrong_words_are_refused_before_anything_runs(words: list[str], tmp_path: Path) -> None:
    assert main(["trade", REFERENCE, "--out", str(tmp_path / "out"), *words]) == 2
    assert not (tmp_path / "out").exists()
