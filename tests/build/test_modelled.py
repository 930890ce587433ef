"""What a run models and leaves out: the decisions, the bound behind them, and that they change nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Pose
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.config.schema.soft_robot import StiffenerTable
from cosim.plan.decision import CONTACT, Decision
from cosim.plan.film_reach import film_reach
from cosim.soft.body.body import hinge_energy_share
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState
from tests.soft.bodies import held, hexagon_arm

GIVEN: dict[str, Any] = {
    "soft_robot": {"file": "hexagon_arm", "stack": {"units": 2}, "cable": [
        {"name": "right", "corner": 0, "units": [1, 2], "capstan_factor": 0.8}]},
    "model.published": True,
    "start.cable_tension_N": [],
    "start.pressure_Pa": 10e3,
    "phase": [{"name": "lower", "duration_s": 0.06, "flange_shift_m": [0.0, 0.0, -0.01]}],
}  # fmt: skip


def found(**changes: Any) -> dict[str, Decision]:
    """Return the decisions of a small scenario by what they are about."""
    stage = build(load_scenario("ur5e_hexagon_arm", {**GIVEN, **changes})).stage
    left_out = stage.report.split("**Left out**")[1]
    for decision in stage.modelled:
        assert (decision.what in left_out) is not decision.included
    return {decision.what: decision for decision in stage.modelled}


def low(height_m: float) -> dict[str, Any]:
    return {"start.flange.position_m": [0.4, 0.0, height_m]}


def test_the_film_stays_within_its_reach() -> None:
    body, pressure = hexagon_arm(3), 60e3
    arm = held(body, NewtonOptions(iterations_max=300))
    pushed = np.zeros((body.nodes, 3))
    farthest = 0.0
    for pull in (np.zeros(3), np.array([0.0, 0.0, 5.0]), np.array([5.0, 0.0, 0.0])):
        pushed[body.tip] = pull / len(body.tip)
        loads = Loads((pressure,), (0.0,) * len(body.cables), (0.0, 0.0, 0.0), pushed)
        hung = arm.equilibrium.solve(
            SoftState.drawn(body, Pose()), Pose(), Loads((), loads.cable_tension_N, (0.0, 0.0, 0.0))
        )
        x = arm.equilibrium.follow(hung, Pose(), loads).state.positions
        farthest = max(farthest, float(np.linalg.norm(x, axis=1).max()))
    drawn = float(np.linalg.norm(body.positions, axis=1).max())
    assert drawn < farthest < film_reach(body, pressure) < 3.0 * farthest


@pytest.mark.parametrize(
    ("changes", "included", "reason"),
    [
        ({}, False, "nothing is within the film's reach"),
        (low(0.2), True, "as far as floor"),
        ({"contact.only_in_reach": False}, True, "required"),
        ({"contact.enabled": False}, False, "switched off"),
        ({"mode": "quasistatic"}, False, "nothing is within the film's reach"),
        ({"mode": "quasistatic", "fidelity": "rigid"}, False, "rigid model has none"),
        ({"phase.lower.gas": "sealed"}, True, "sealed gas"),
        (
            {"object": [{"name": "ball", "shape": "sphere", "size_m": [0.02], "position_m": [0.6, 0.6, 0.02],
                         "mass_kg": 0.1}]},
            True,
            "ball can move",
        ),
        (
            {"mode": "quasistatic",
             "object": [{"name": "ball", "shape": "sphere", "size_m": [0.02], "position_m": [0.3, 0.0, 0.6],
                         "mass_kg": 0.1}]},
            False,
            "nothing is within",
        ),
        # the largest pressure of all phases counts: at rest the reach is 0.15 m
        ({"start.pressure_Pa": 0.0, "phase.lower.pressure_Pa": 100e3}, False, "film's reach of 0.19 m"),
        (
            {"phase": [{"name": "hold", "duration_s": 0.06, "clamp": ["unit_1.outer"]},
                       {"name": "let_go", "duration_s": 0.06, "release": ["unit_1.outer"]}]},
            True,
            "rings are released",
        ),
        (
            {"object": [{"name": "wall", "shape": "box", "size_m": [0.1, 1.0, 1.0],
                         "position_m": [0.45, 0.0, 0.7]}]},
            True,
            "as far as wall",
        ),
    ],
)  # fmt: skip
def test_contact_is_searched_for_where_something_can_be_touched(
    changes: dict[str, Any], included: bool, reason: str
) -> None:
    decision = found(**changes)[CONTACT]
    assert decision.included is included
    assert reason in decision.reason


def test_leaving_out_what_is_out_of_reach_changes_no_bit() -> None:
    runs = [
        cosim.run("ur5e_hexagon_arm", overrides={**GIVEN, "contact.only_in_reach": only})
        for only in (True, False)
    ]
    assert (runs[0].tip_position == runs[1].tip_position).all()
    assert (runs[0].flange_force == runs[1].flange_force).all()
    included = [
        {entry["what"]: entry["included"] for entry in run.summary["modelled"]}[CONTACT] for run in runs
    ]
    assert included == [False, True]


def test_cables_and_elasticity_and_inertia() -> None:
    slack, rigid = found(), found(fidelity="rigid", mode="quasistatic")
    assert "slack throughout" in slack["cables"].reason
    assert not slack["cables"].included
    assert found(**{"phase.lower.cable_tension_N": [1.0]})["cables"].included
    winch = {"name": "motor", "cables": ["right"], "step_angle_rad": 0.002, "drum_radius_m": 0.01,
             "step_rate_per_s": 2e4, "stall_torque_Nm": 0.3}  # fmt: skip
    assert found(winch=[winch])["cables"].included
    assert slack["elasticity"].included
    assert slack["inertia"].included
    assert "quasistatic' would leave out little" not in slack["inertia"].reason
    gentle = found(**{"phase.lower.duration_s": 4.0})["inertia"].reason
    assert "quasistatic' would leave out little" in gentle
    # duration and percentage of gravity: from 1 % on, inertia is worth its time
    for duration_s, percent, little in ((0.72, "1.1 %", False), (0.8, "0.92 %", True)):
        reason = found(**{"phase.lower.duration_s": duration_s})["inertia"].reason
        assert f"up to {percent} of gravity" in reason
        assert ("quasistatic' would leave out little" in reason) is little
    # in place, the flange turns fast: its origin rests, the arm's end does not
    turn = {"axis": [0.0, 1.0, 0.0], "angle_rad": 0.5}
    swing = [{"name": "lower", "duration_s": 0.2, "flange_turn": turn}]
    assert "would leave out little" not in found(phase=swing)["inertia"].reason
    for what in ("elasticity", "inertia", "cables", "hinges"):
        assert not rigid[what].included
    assert not found(**{"soft_robot.hinge.stiffness_factor": 0.0})["hinges"].included


def test_the_hinges_share_of_the_energy() -> None:
    body = hexagon_arm(2)
    x = body.positions * np.array([1.0, 1.0, 3.0])
    share = hinge_energy_share(body, x)
    assert 0.0 < share < 1.0
    doubled = hexagon_arm(2, hinge_stiffness=2.0 * body.hinges.stiffness)
    # U_h -> 2 U_h: s -> 2 s / (1 + s)
    assert hinge_energy_share(doubled, x) == pytest.approx(2.0 * share / (1.0 + share))


def test_the_summary_tells_the_share_of_every_phase() -> None:
    result = cosim.run("ur5e_hexagon_arm", overrides=GIVEN)
    (phase,) = result.summary["phases"]
    assert 0.0 < phase["hinge_energy_share"] < 0.5


@pytest.mark.parametrize(("strength", "warned"), [(0.05, False), (0.002, True), (None, False)])
def test_stiffeners_beyond_their_strength_are_told(strength: float | None, warned: bool) -> None:
    beam = StiffenerTable("beam", width_m=2e-3, height_m=2e-3, young_modulus_Pa=2e9, strength_strain=strength)
    scenario = load_scenario("three_unit_inflation", {"model.published": False})
    run = cosim.run(replace(scenario, soft_robot=replace(scenario.soft_robot, stiffener=beam)))
    figures = run.summary["phases"][-1]["stiffener"]
    assert 0.003 < figures["peak_strain"] < 0.02
    assert figures["strength_strain"] == strength
    named = f"'{run.summary['phases'][-1]['name']}' stiffeners may break"
    assert (named in " ".join(run.summary["warnings"])) is warned
    assert "**Stiffeners**: beams of 2 x 2 mm, 2 GPa" in run.stage.report


def test_a_linear_ramp_that_the_first_tick_does_not_resolve_is_named() -> None:
    ramped = {"name": "inflate", "duration_s": 0.06, "pressure_Pa": 15e3}
    named = "first tick of a linear ramp"
    assert named not in found(phase=[ramped])
    decision = found(phase=[ramped | {"ramp": "linear"}])[named]
    assert not decision.included
    assert decision.reason == "phase 'inflate' begins with a jump of the loads' rate"
    assert named not in found(phase=[*GIVEN["phase"], ramped | {"ramp": "linear"}])
