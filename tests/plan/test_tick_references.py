"""What the servos are asked to follow, across the boundaries of phases."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.build.arms import find_arm
from cosim.config.loading import load_scenario
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.kinematics.arm import Arm
from cosim.plan.flange_motion import pose_of
from cosim.plan.joint_path import JointReference
from cosim.plan.joint_planner import plan_joints
from cosim.plan.planning import make_plan
from cosim.plan.ramp import progress
from cosim.plan.references import TickReferences
from cosim.plan.static_plan import solved_phases
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from tests.soft.bodies import hexagon_arm

TICK_S = 0.002
SHIFT = {"flange_shift_m": [0.03, 0.05, -0.04]}
BOTH = {**SHIFT, "flange_turn": {"axis": [0.0, 1.0, 0.0], "angle_rad": 0.2}}
SHAKEN = {**SHIFT, "flange_shake": {"axis": [0.0, 0.0, 1.0], "amplitude_m": 0.005, "frequency_Hz": 5.0}}


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(find_arm("ur5e"))


def references(arm: Arm, *phases: dict[str, Any]) -> JointReference:
    """Return what is asked of the joints at the start of every tick, phase after phase."""
    named = [{"name": f"p{k}", "ramp": "linear", **phase} for k, phase in enumerate(phases)]
    scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True, "phase": named})
    body, start = hexagon_arm(2), pose_of(scenario.start.flange)
    soft = FilmRobot(body, start, NewtonOptions(), StepOptions())
    plan = make_plan(scenario, partial(plan_joints, arm), body, partial(solved_phases, scenario, soft))
    found = []
    for planned in plan.phases:
        rows = TickReferences(planned, TICK_S)
        ticks = round((planned.phase.duration_s + planned.phase.settle_s) / TICK_S)
        found += [rows.at(done)[0] for done in range(1, ticks + 1)]
    return JointReference(
        np.array([row.position for row in found]),
        np.array([row.velocity for row in found]),
        np.array([row.acceleration for row in found]),
    )


def flange_speeds(arm: Arm, asked: JointReference) -> Array:
    """Return the flange's speed [m/s] and rate of turning [rad/s] (ticks, 2) that are asked for."""
    pairs = zip(asked.position, asked.velocity, strict=True)
    twists = np.array([arm.jacobian(q) @ velocity for q, velocity in pairs])
    return np.linalg.norm(twists.reshape(-1, 2, 3), axis=2)


@pytest.mark.parametrize("way", [SHIFT, BOTH])
@pytest.mark.parametrize("duration_s", [0.8, 0.7995])  # the second is no whole number of ticks
def test_equal_linear_phases_are_one_motion_at_constant_speed(
    arm: Arm, way: dict[str, Any], duration_s: float
) -> None:
    asked = references(arm, *[{**way, "duration_s": duration_s}] * 3)
    speeds, length = flange_speeds(arm, asked), float(np.linalg.norm(SHIFT["flange_shift_m"]))
    assert speeds[:, 0] == pytest.approx(length / 0.8, rel=1e-6)
    assert speeds[:, 1] == pytest.approx(0.25 if way is BOTH else 0.0, abs=1e-6)
    # the path goes by the mean of the rates at both ends of every tick, up to the third derivative
    steps = np.diff(asked.position, axis=0) / TICK_S
    means = 0.5 * (asked.velocity[1:] + asked.velocity[:-1])
    assert np.abs(steps - means).max() < 1e-6
    assert np.abs(np.diff(asked.velocity, axis=0) / TICK_S).max() < 1.2 * np.abs(asked.acceleration).max()


def test_a_shake_neither_brakes_nor_pushes_where_it_begins_and_ends(arm: Arm) -> None:
    asked = references(
        arm, {**SHIFT, "duration_s": 0.8}, {**SHAKEN, "duration_s": 0.8}, {**SHIFT, "duration_s": 0.8}
    )
    jumps = np.abs(np.diff(asked.velocity, axis=0)).max(axis=1)
    assert max(jumps[398:402].max(), jumps[798:802].max()) < 0.1 * jumps[410:790].max()
    speeds = flange_speeds(arm, asked)[:, 0]
    assert speeds[[399, 400, 800]] == pytest.approx(speeds[0], rel=1e-6)


def test_a_linear_motion_has_its_speed_from_its_first_tick_to_its_last(arm: Arm) -> None:
    asked = references(arm, {**SHIFT, "duration_s": 0.8, "settle_s": 0.1})
    forward = np.diff(asked.position, axis=0) / TICK_S
    moving = np.abs(asked.velocity).max(axis=1) > 0.0
    assert moving.tolist() == [True] * 400 + [False] * 50
    # what a tick begins with is where it goes, also in the ticks after the start and before the end
    assert np.abs(forward - asked.velocity[:-1]).max() < 0.01 * np.abs(asked.velocity).max()


@pytest.mark.parametrize(("time_s", "rate"), [(-1e-9, 0.0), (0.0, 2.0), (0.25, 2.0), (0.5, 0.0), (0.6, 0.0)])
def test_the_start_belongs_to_a_linear_ramp_and_the_end_to_what_follows(time_s: float, rate: float) -> None:
    found = progress("linear", time_s, 0.5)
    assert (found.rate, found.acceleration) == (rate, 0.0)
    assert found.value == pytest.approx(min(max(2.0 * time_s, 0.0), 1.0))


def test_a_tick_that_rounding_puts_before_the_end_is_the_end() -> None:
    time_s = 0.3 - 1e-16 * 3
    assert progress("linear", time_s, 0.3).rate == 0.0
    assert progress("step", 0.0, 0.3).value == progress("smooth", 0.0, 0.3).value == 0.0
