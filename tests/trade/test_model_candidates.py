"""Candidates that differ in what is modelled: each decision of a run has one, all with the same commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_vector
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.plan.motion import pose_of
from cosim.trade.candidates import Candidate, candidates_of, model_candidates
from cosim.trade.measuring import flange_pose, measure, with_commands
from cosim.trade.report import markdown
from tests.trade.test_trade import small

REFERENCE, GRASP = "ur5e_hexagon_arm", "gripper_lifts_roll"
PUBLISHED = {"model.published": True}


def lifted() -> Scenario:
    """Return two units on a held base whose tip is pulled up to a height."""
    cable = {"name": "left", "corner": 0, "units": [1, 2], "capstan_factor": 0.8}
    phases = [
        {"name": "inflate", "duration_s": 0.1, "pressure_Pa": 20e3},
        {"name": "lift", "duration_s": 0.1, "tip_target": {"height_m": 0.6594, "reach_with": "cables"}},
    ]
    robot = {"file": "hexagon_arm", "stack": {"units": 2}, "cable": [cable]}
    return small(soft_robot=robot, phase=phases, **{"start.cable_tension_N": [0.0]})


@pytest.mark.parametrize("name", [REFERENCE, GRASP, "hexagon_arm_curls"])
def test_every_decision_of_a_run_has_a_candidate_that_decides_otherwise(name: str) -> None:
    phases = [{"name": "rest", "duration_s": 0.1}]
    scenario = load_scenario(name, {"phase": phases, "mode": "dynamic"})
    # no candidate is of other losses of cables, whose plans take three times as long, or of other rigid steps
    decided = {
        entry.what for entry in build(scenario).stage.modelled if entry.what != "direction of cable losses"
    }
    decided = {what for what in decided if not what.startswith("rigid steps")}
    assert decided == {candidate.decision for candidate in candidates_of(scenario, quick=True)} - {""}


def test_candidates_of_a_scenario_with_a_light_object_keep_its_tick() -> None:
    grasp, arm = load_scenario(GRASP, PUBLISHED), load_scenario(REFERENCE, PUBLISHED)
    for scenario, tick_s in ((grasp, grasp.clock.tick_s), (arm, 0.01)):
        models = [
            candidate for candidate in candidates_of(scenario, quick=True) if candidate.group == "model"
        ]
        assert {candidate.changes["clock.tick_s"] for candidate in models} == {tick_s}


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.4], [3.0, 0.2, -0.5], [0.1, -1.2, 0.8]])
def test_a_pose_of_the_flange_survives_its_table(turn: list[float]) -> None:
    pose = Pose(rotation_from_vector(np.array(turn)), np.array([0.1, -0.2, 0.3]))
    again = pose_of(flange_pose(pose))
    np.testing.assert_allclose(again.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(again.translation, pose.translation, atol=1e-15)


def test_commands_in_place_of_targets_lead_the_same_way() -> None:
    scenario = load_scenario(REFERENCE, PUBLISHED)
    simulation = build(scenario)
    commanded = with_commands(scenario, lambda _scenario: simulation)
    assert all(phase.tip_target is None for phase in commanded.phases)
    lift, reach = commanded.phases[-2:]
    assert lift.cable_tension_N is not None
    assert min(lift.cable_tension_N) > 1.0
    assert reach.flange is not None
    for ours, theirs in zip(simulation.plan.phases, build(commanded).plan.phases, strict=True):
        np.testing.assert_allclose(ours.flange.rotation, theirs.flange.rotation, atol=1e-12)
        np.testing.assert_allclose(ours.flange.translation, theirs.flange.translation, atol=1e-12)
        np.testing.assert_array_equal(ours.end.cable_tension_N, theirs.end.cable_tension_N)
    plain = replace(scenario, phases=scenario.phases[:1])
    assert with_commands(plain, build) is plain


def test_the_next_best_reference_tells_the_error_of_the_best() -> None:
    """Of several references the first that runs to its end is taken."""
    lost = {"phase.inflate.pressure_Pa": 20e3, "solver.dynamic_newton_iterations": 1, "clock.tick_s": 0.05}
    candidates = [
        Candidate("lost", "model", {**lost, "soft_robot.film.young_modulus_Pa": 1e4}, reference=True),
        Candidate("finer", "model", {"clock.tick_s": 0.005}, reference=True),
        Candidate("coarser", "model", {"clock.tick_s": 0.01}, reference=True),
        Candidate("other", "model", {"clock.tick_s": 0.02}),
    ]
    failed, finer, coarser, other = results = measure(lifted(), candidates, build)
    assert failed.failure
    assert [result.reference for result in results] == [False, True, False, False]
    assert finer.tip_error_m == 0.0
    assert 0.0 < coarser.tip_error_m < other.tip_error_m
    told = f'about {1e3 * coarser.tip_error_m:.3g} mm, its distance from "coarser"'
    assert told in markdown("two units", results)
    again = Candidate("finer again", "model", finer.candidate.changes, reference=True)
    assert "The reference itself" not in markdown(
        "two units", measure(lifted(), [finer.candidate, again], build)
    )


def test_the_truth_is_the_wrinkling_film_on_finer_meshes_of_all_parts() -> None:
    scenario = load_scenario(GRASP, PUBLISHED)
    best, next_best, own, *others = model_candidates(scenario, (), quick=False)
    assert [entry.reference for entry in (best, next_best, own, *others[:2])] == [
        True,
        True,
        True,
        False,
        False,
    ]
    finer, coarser = (load_scenario(scenario, entry.changes).soft_robot for entry in (best, next_best))
    assert finer.film.law == coarser.film.law == "wrinkling"
    assert finer.stack.refine == coarser.stack.refine + 1 > scenario.soft_robot.stack.refine


def test_switches_are_measured_against_the_model_as_it_is() -> None:
    softer = {"soft_robot.film.young_modulus_Pa": 1e8}
    candidates = [
        Candidate("finer", "model", {"clock.tick_s": 0.005, **softer}, reference=True, commanded=True),
        Candidate("as it is", "model", {"clock.tick_s": 0.01}, base=True, commanded=True),
        Candidate("the same", "model", {"clock.tick_s": 0.01}, commanded=True),
        Candidate("other", "model", {"clock.tick_s": 0.01, **softer}, commanded=True),
    ]
    finer, base, same, other = measure(lifted(), candidates, build)
    assert np.isnan(finer.base_error_m)
    assert base.base_error_m == same.base_error_m == 0.0
    assert same.tip_error_m > 1e-5
    assert other.base_error_m > 1e-5
