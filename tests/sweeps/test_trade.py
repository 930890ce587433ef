"""`cosim trade`: candidates, errors against the reference, Pareto front, choice, files."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

import cosim
from cosim.app.output_directory import OutputDirectory
from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.simulation import build
from cosim.cli import trade as command
from cosim.cli.main import main
from cosim.config.loading import load_scenario, scenario_text
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.reading import parse_assignment
from cosim.errors import InputError
from cosim.plan.flange_motion import pose_of
from cosim.sweeps.candidates import Candidate, candidates_of
from cosim.sweeps.designs import Row
from cosim.sweeps.engines import Engine
from cosim.sweeps.study_run import SweepProgress
from cosim.sweeps.tracer import sampled
from cosim.sweeps.trade import commands_of, compare, flange_pose, measure
from cosim.sweeps.trade_choice import Requirement, choice_line, pareto_front, pick
from cosim.sweeps.trade_report import draw, markdown
from cosim.sweeps.trade_results import Measured

REFERENCE, GRASP = "ur5e_hexagon_arm", "gripper_lifts_roll"
PUBLISHED = {"model.published": True}
MADE_UP = [("fast", 8.0, 0.02), ("slow and bad", 1.0, 0.03), ("middle", 4.0, 0.005), ("good", 0.5, 0.001)]
Runs: TypeAlias = Callable[[Scenario, Sequence[Candidate]], list[Measured]]


def made_up() -> list[Measured]:
    """Return a reference and four candidates with given speeds and errors."""
    changes = {"clock.tick_s": 0.001, "phase.a.duration_s": 1.0}
    reference = Measured(Candidate("finest", changes, reference=True), 0.1, 0.2, 2.0, reference=True)
    rows = [
        Measured(
            Candidate(f"{name}, 1 ms, 1 tangent", changes),
            factor, 9.0, 2.0, error, error, error, force_error_N=10.0 * error, contact_error_N=0.3,
        )
        for name, factor, error in MADE_UP
    ]  # fmt: skip
    return [
        reference,
        *rows,
        Measured(Candidate("lost", changes), failure="failed: ConvergenceError: no; at all"),
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


def lifted() -> Scenario:
    """Return two units on a held base whose tip is pulled up to a height."""
    cable = {"name": "left", "corner": 0, "units": [1, 2], "capstan_factor": 0.8}
    phases = [
        {"name": "inflate", "duration_s": 0.1, "pressure_Pa": 20e3},
        {"name": "lift", "duration_s": 0.1, "tip_target": {"height_m": 0.6594, "reach_with": "cables"}},
    ]
    robot = {"file": "hexagon_arm", "stack": {"units": 2}, "cable": [cable]}
    return small(soft_robot=robot, phase=phases, **{"start.cable_tension_N": [0.0]})


@pytest.fixture
def runs(tmp_path: Path) -> Iterator[Runs]:
    """Return what runs candidates in this process, each call in a folder of its own."""
    folders = (tmp_path / str(number) for number in range(100))
    with ThreadPoolExecutor(1) as executor:

        def run(scenario: Scenario, candidates: Sequence[Candidate]) -> list[Measured]:
            with OutputDirectory(next(folders)) as directory:
                return measure(scenario, candidates, directory, Engine(executor), (), lambda _progress: None)

        yield run


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
    assert choice_line(made_up(), requirement).endswith("Run it with: --set clock.tick_s=0.001")


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


def test_words_that_are_printed_change_what_a_candidate_changes() -> None:
    scenario = load_scenario(REFERENCE)
    published = Candidate("", {"model.published": False}).words
    assert load_scenario(REFERENCE, dict([parse_assignment(published.removeprefix("--set "))])) == scenario


def test_budgets_and_tolerances_have_units() -> None:
    assert command.parse_budget("1.5x") == command.parse_budget("1.5") == 1.5
    for text, metres in (("1mm", 1e-3), ("50um", 5e-5), ("0.2cm", 2e-3), ("0.01", 0.01), ("1m", 1.0)):
        assert command.parse_tolerance(text) == pytest.approx(metres)
    assert command.parse_force("0.1N") == 0.1
    for text in ("fast", "-1x", "0", "nan", "inf"):
        with pytest.raises(InputError, match="real-time factor"):
            command.parse_budget(text)
        with pytest.raises(InputError, match="length"):
            command.parse_tolerance(text)
        with pytest.raises(InputError, match="force"):
            command.parse_force(text)


def test_the_table_and_the_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    table = markdown("made up", made_up())
    assert "| * | middle, 1 ms, 1 tangent | 4.00 | 9.00 | 5 | 5 | 5 | 0.05 | 0.3 | 2.00 |" in table
    assert "| ref | finest | 0.10 | 0.20 |" in table
    assert "failed: ConvergenceError: no |" in table
    draw("made up", made_up(), tmp_path / "trade.png")
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("quick", [False, True])
def test_candidates_all_load_with_shorter_phases(quick: bool) -> None:
    scenario = load_scenario(REFERENCE, PUBLISHED)
    first, *others = candidates = candidates_of(scenario, quick=quick, time_scale=0.5)
    assert len({candidate.name for candidate in candidates}) == len(candidates)
    assert [candidate for candidate in candidates if candidate.reference] == [first]
    assert first.changes["clock.tick_s"] < min(each.changes["clock.tick_s"] for each in others)
    fidelities = {"rigid", "section", "lumped", *([] if quick else ["refined"])}
    assert {candidate.changes["fidelity"] for candidate in candidates} == fidelities
    for candidate in candidates:
        changed = load_scenario(scenario, candidate.changes)
        seconds = [sum(p.duration_s + p.settle_s for p in run.phases) for run in (changed, scenario)]
        assert seconds[0] == pytest.approx(0.5 * seconds[1], abs=0.2)
        for phase in changed.phases:
            ticks = phase.duration_s / changed.clock.tick_s
            assert ticks == pytest.approx(round(ticks), abs=1e-6)


def test_against_the_refined_mesh_the_references_are_wrinkling_films_on_finer_meshes() -> None:
    scenario = load_scenario(REFERENCE, PUBLISHED)
    one = candidates_of(scenario, truth="refined")
    references = [candidate.name for candidate in one if candidate.reference]
    assert references == ["wrinkling film, refine +1", "wrinkling film, refine +0", "refined once more"]
    assert {candidate.name for candidate in candidates_of(scenario)} == {
        candidate.name for candidate in one if not candidate.name.startswith("wrinkling")
    }
    with pytest.raises(InputError, match="no refined mesh"):
        candidates_of(scenario, quick=True, truth="refined")
    grasp = load_scenario(GRASP, PUBLISHED)  # of several parts
    best, next_best = candidates_of(grasp, truth="refined")[:2]
    finer, coarser = (load_scenario(grasp, entry.changes).soft_robot for entry in (best, next_best))
    assert finer.film.law == coarser.film.law == "wrinkling"
    assert finer.stack.refine == coarser.stack.refine + 1 > grasp.soft_robot.stack.refine
    # a light object does not stand long ticks
    assert best.changes["clock.tick_s"] == grasp.clock.tick_s != one[0].changes["clock.tick_s"]


def test_candidates_need_a_dynamic_run_and_a_positive_factor() -> None:
    with pytest.raises(InputError, match="quasistatic"):
        candidates_of(load_scenario(REFERENCE, {"mode": "quasistatic"}))
    with pytest.raises(InputError, match="time scale"):
        candidates_of(load_scenario(REFERENCE, PUBLISHED), time_scale=0.0)


def test_errors_shrink_with_the_tick_at_the_integrators_order(runs: Runs) -> None:
    converged = {"solver.dynamic_newton_iterations": 50, "solver.dynamic_tolerance_N": 1e-8}
    finest = {**converged, "clock.tick_s": 2.5e-4, "solver.integrator": "bdf2"}
    candidates = [Candidate("finest", finest, reference=True)]
    for integrator in ("implicit_euler", "bdf2"):
        for tick in (0.002, 0.001):
            changes = {**converged, "clock.tick_s": tick, "solver.integrator": integrator}
            candidates.append(Candidate(f"{integrator} {tick}", changes))
    # slow and damped, so that the errors are those of the motion and not of the film's vibrations
    phase = {"name": "inflate", "duration_s": 0.4, "pressure_Pa": 20e3}
    slow = small(**{"start.pressure_Pa": 10e3, "solver.damping_per_s": 60.0, "phase": [phase]})
    results = runs(slow, candidates)
    assert results[0].tip_error_m == 0.0
    euler, half_euler, bdf2, half_bdf2 = results[1:]
    for name in ("tip_error_m", "tip_rms_m"):
        assert getattr(euler, name) / getattr(half_euler, name) == pytest.approx(2.0, abs=0.25)
        assert getattr(bdf2, name) / getattr(half_bdf2, name) == pytest.approx(4.0, abs=0.7)
        assert getattr(bdf2, name) < 0.5 * getattr(euler, name)
    assert euler.force_error_N / half_euler.force_error_N == pytest.approx(2.0, abs=0.25)
    assert bdf2.force_error_N < 0.1 * euler.force_error_N
    for result in results:
        assert result.loop_factor > result.real_time_factor > 0.0  # a command also starts and builds
        assert np.isfinite([result.tip_error_m, result.end_error_m, result.force_error_N]).all()
        assert result.tip_error_m >= result.tip_rms_m
    assert not results[0].comparable
    assert results[1].force_error_N > 1e-4


def test_with_an_arm_errors_are_of_second_order_in_the_tick(runs: Runs) -> None:
    turn = {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.2}
    changes = {
        "soft_robot": {"file": "hexagon_arm", "stack": {"units": 2}, "cable": []},
        "model.published": True,
        "start.pressure_Pa": 10e3,
        "start.cable_tension_N": [],
        "phase": [{"name": "turn", "duration_s": 0.4, "flange_turn": turn}],
        "solver.damping_per_s": 20.0,  # the errors are those of the motion, not of the film's vibrations
        "solver.dynamic_newton_iterations": 50,
        "solver.dynamic_tolerance_N": 1e-8,
    }
    scenario = load_scenario(REFERENCE, changes)

    def error(coarser_s: float, finer_s: float) -> Measured:
        finer = Candidate("finer", {"clock.tick_s": finer_s}, reference=True)
        return runs(scenario, [finer, Candidate("coarser", {"clock.tick_s": coarser_s})])[1]

    first, second = error(2e-3, 1e-3), error(1e-3, 5e-4)
    assert first.tip_error_m / second.tip_error_m == pytest.approx(4.0, abs=0.2)
    assert first.force_error_N / second.force_error_N == pytest.approx(4.0, abs=0.5)
    assert second.tip_error_m > 1e-8  # far above what the solver leaves


def mean_force(tick_s: float, force_N: Array) -> Array:
    """Return the moving mean of a force along x, one value a tick."""
    force = np.outer(force_N, [1.0, 0.0, 0.0])
    return sampled(tick_s * np.arange(len(force_N)), {}, force)["force_N"][:, 0]


def test_the_force_is_compared_by_its_moving_mean() -> None:
    chatter = np.where(np.arange(201) % 2, -1.0, 1.0)  # 1 N at every compared time
    assert mean_force(1e-3, chatter) == pytest.approx(0.0, abs=1e-12)
    assert mean_force(1e-3, chatter + 0.3) == pytest.approx(0.3)
    # half of a window is of a force that begins within it, and the whole run where that is shorter
    begins = np.where(np.arange(201) < 160, 0.0, 1.0)
    assert mean_force(1e-3, begins).max() == pytest.approx(1.0)
    assert mean_force(1e-3, begins[150:171]) == pytest.approx(0.525)
    between = np.where(np.arange(201) % 20, 1.0, 0.0)  # nothing at the compared times
    assert mean_force(1e-3, between) == pytest.approx(0.95)
    # windows are of time, not of ticks
    ramps = [
        mean_force(each, 5.0 * each * np.arange(round(0.21 / each) + 1)) for each in (1e-3, 1.5e-2, 3e-2)
    ]
    assert ramps[1] == pytest.approx(ramps[0], abs=1e-12)
    assert ramps[2] == pytest.approx(ramps[0], abs=1e-12)


def test_objects_that_can_move_are_compared() -> None:
    still = {name: [[0.0, 0.0, 0.0]] * 2 for name in ("tip_m", "force_N", "end_tip_m")}
    places = [[[0.0, 0.0, 0.0]]] * 2, [[[0.0, 0.0, 0.0]], [[0.0, 0.3, 0.4]]]
    rows = [
        Row(
            "completed",
            None,
            {"real_time_factor": 1.0, "loop_factor": 2.0, "iterations": 1.0, "curves": curves},
        )
        for curves in ({**still, "contact_N": [0.0, 0.0], "objects_m": each} for each in places)
    ]
    candidates = Candidate("reference", {}, reference=True), Candidate("other", {})
    other = compare(candidates, rows)[1]
    assert other.object_error_m == other.position_error_m == pytest.approx(0.5)
    assert other.tip_error_m == 0.0


def test_a_candidate_that_fails_or_is_too_slow_leaves_the_others(runs: Runs) -> None:
    candidates = [
        Candidate("finest", {"clock.tick_s": 0.005}, reference=True),
        Candidate("impossible", {"clock.tick_s": 0.01, "start.pressure_Pa": "high"}),
        Candidate("slow", {"clock.tick_s": 0.01}, slowest=1e9),  # no machine is that fast
        Candidate("coarse", {"clock.tick_s": 0.01}),
    ]
    _, impossible, slow, coarse = results = runs(small(), candidates)
    assert [bool(result.failure) for result in results] == [False, True, True, False]
    assert "ScenarioError" in impossible.failure
    assert slow.failure.startswith("stopped: slower than x1e+09 real time at 0.00 s, in 'inflate'")
    assert "| slow | stopped: slower than x1e+09 real time" in markdown("made up", results)
    assert coarse.comparable


def test_the_first_completed_reference_is_used_and_the_next_shows_its_error(runs: Runs) -> None:
    lost = {"phase.inflate.pressure_Pa": 20e3, "solver.dynamic_newton_iterations": 1, "clock.tick_s": 0.05}
    candidates = [
        Candidate("lost", {**lost, "soft_robot.film.young_modulus_Pa": 1e4}, reference=True),
        Candidate("finer", {"clock.tick_s": 0.005}, reference=True, commanded=True),
        Candidate("coarser", {"clock.tick_s": 0.01}, reference=True, commanded=True),
        Candidate("other", {"clock.tick_s": 0.02}),
    ]
    failed, finer, coarser, other = results = runs(lifted(), candidates)
    assert failed.failure
    assert [result.reference for result in results] == [False, True, False, False]
    assert finer.tip_error_m == 0.0
    assert 0.0 < coarser.tip_error_m < other.tip_error_m
    told = f'about {1e3 * coarser.tip_error_m:.3g} mm, its distance from "coarser"'
    assert told in markdown("two units", results)
    assert "The reference itself" not in markdown("two units", [failed, finer, other])


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.4], [3.0, 0.2, -0.5], [0.1, -1.2, 0.8]])
def test_a_pose_of_the_flange_survives_its_table(turn: list[float]) -> None:
    pose = Pose(rotation_from_vector(np.array(turn)), np.array([0.1, -0.2, 0.3]))
    again = pose_of(flange_pose(pose))
    np.testing.assert_allclose(again.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(again.translation, pose.translation, atol=1e-15)


def test_commands_instead_of_targets_give_the_same_run() -> None:
    scenario = load_scenario(REFERENCE, PUBLISHED)
    commanded = load_scenario(scenario, commands_of(scenario))
    assert all(phase.tip_target is None for phase in commanded.phases)
    lift, reach = commanded.phases[-2:]
    assert lift.cable_tension_N is not None
    assert min(lift.cable_tension_N) > 1.0
    assert reach.flange is not None
    for ours, theirs in zip(build(scenario).plan.phases, build(commanded).plan.phases, strict=True):
        np.testing.assert_allclose(ours.flange.rotation, theirs.flange.rotation, atol=1e-12)
        np.testing.assert_allclose(ours.flange.translation, theirs.flange.translation, atol=1e-12)
        np.testing.assert_array_equal(ours.end.cable_tension_N, theirs.end.cable_tension_N)
    assert commands_of(replace(scenario, phases=scenario.phases[:1])) == {}


def test_the_command_writes_its_files_and_measures_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    ticks = {"finest": 0.005, "coarse": 0.01, "coarser": 0.02}
    candidates = [Candidate(name, {"clock.tick_s": tick}, name == "finest") for name, tick in ticks.items()]
    monkeypatch.setattr(command, "candidates_of", lambda _scenario, **_how: candidates)
    file, out = tmp_path / "small.toml", tmp_path / "out"
    file.write_text(scenario_text(small()), encoding="utf-8")
    words = ["trade", str(file), "--out", str(out)]
    assert main([*words, "--tolerance", "1m"]) == 0
    written = capsys.readouterr().out
    assert "Run it with: --set clock.tick_s=0.0" in written
    assert (out / "trade.md").read_text(encoding="utf-8") in written
    assert (out / "trade.png").exists()
    frame = cosim.open_sweep(out)
    assert frame["candidate"].tolist() == list(ticks)
    assert frame["clock.tick_s"].tolist() == list(ticks.values())
    assert frame["tip_error_m"].tolist() == sorted(frame["tip_error_m"])
    assert frame["tip_error_m"][0] == 0.0 < frame["tip_error_m"][1]
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # as where it is not installed
    seen: list[SweepProgress] = []
    monkeypatch.setattr("cosim.cli.main.SweepLine", lambda _stream: seen.append)
    assert main([*words, "--budget", "1e12x"]) == 1
    captured = capsys.readouterr()
    assert "No candidate meets budget real-time factor 1e+12." in captured.out
    assert "need matplotlib" in captured.err
    assert (seen[-1].done, seen[-1].computed) == (3, 0)


@pytest.mark.parametrize(
    "words",
    [["--budget", "fast"], ["--tolerance", "0"], ["--scale-time", "-1"], ["--set", "clock.tck_s=1"]],
)  # fmt: skip
def test_wrong_words_are_refused_before_anything_runs(words: list[str], tmp_path: Path) -> None:
    assert main(["trade", REFERENCE, "--out", str(tmp_path / "out"), *words]) == 2
    assert not (tmp_path / "out").exists()
