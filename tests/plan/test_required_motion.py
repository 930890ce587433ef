"""What a plan asks of the joints: derivatives of one another, and jumps where phases do not meet."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cosim.base.frames import Pose
from cosim.config.schema.phase import PhaseTable
from cosim.plan.commands import SoftCommand
from cosim.plan.joint_path import JointPath
from cosim.plan.plan import Holding, PhasePlan, Plan
from cosim.plan.ramp import progress
from cosim.plan.required_motion import RequiredMotion, required_motion

TICK_S, DURATION_S = 2e-3, 0.5
SPAN = np.array([0.3, -0.1, 0.2, 0.0, 0.5, -0.4])


def quickening(first: float, gain: float) -> JointPath:
    """Return a path that begins at `first` SPAN and goes on by (s + gain s^2) SPAN."""
    s = np.linspace(0.0, 1.0, 5)
    return JointPath(first * SPAN, CubicSpline(s, np.outer(first + s + gain * s**2, SPAN)))


def asked(*paths: JointPath, settle_s: float = 0.0) -> RequiredMotion:
    """Return what linear phases ask for, the last of which is held at its end."""
    idle = SoftCommand((), (), (), ())
    nothing = Holding(np.zeros(0, np.int64), np.zeros((0, 3), dtype=bool))
    phases = tuple(
        PhasePlan(
            PhaseTable(f"p{k}", DURATION_S, settle_s if k == len(paths) - 1 else 0.0, ramp="linear"),
            path, idle, idle, (), nothing, None, Pose(),
        )
        for k, path in enumerate(paths)
    )  # fmt: skip
    return required_motion(Plan(Pose(), paths[0].first, idle, (0.0, 0.0, 0.0), phases), TICK_S)


@pytest.mark.parametrize("ramp", ["smooth", "linear"])
def test_speed_and_acceleration_are_derivatives(ramp: Literal["smooth", "linear"]) -> None:
    path, step_s = quickening(0.2, 1.5), 1e-4
    times = (0.1, 0.2, 0.37)
    for time_s in times:
        before, here, after = (
            path.at(progress(ramp, time_s + shift, DURATION_S)) for shift in (-step_s, 0.0, step_s)
        )
        # the differences' own error is of the order of step^2 / duration^2: 4e-8, times a few
        speed = (after.position - before.position) / (2.0 * step_s)
        np.testing.assert_allclose(here.velocity, speed, atol=1e-5)
        acceleration = (after.velocity - before.velocity) / (2.0 * step_s)
        np.testing.assert_allclose(here.acceleration, acceleration, atol=1e-4)


def test_phases_that_meet_at_one_speed_ask_for_no_jump() -> None:
    # all begin with a speed of SPAN / duration, and end with 1 + 2 gain times that
    motion = asked(quickening(0.0, 0.0), quickening(1.0, 0.5), quickening(2.5, 0.0))
    start, even, slower = motion.joints.acceleration[motion.jumps]
    np.testing.assert_allclose(start, SPAN / DURATION_S / TICK_S, rtol=1e-6)
    np.testing.assert_allclose(even, 0.0, atol=1e-3)
    np.testing.assert_allclose(slower, -SPAN / DURATION_S / TICK_S, rtol=1e-6)
    speeds = motion.joints.velocity[motion.jumps]
    np.testing.assert_allclose(speeds, np.tile(SPAN / DURATION_S, (3, 1)), rtol=1e-6)


def test_who_stops_brakes_from_the_speed_at_the_end() -> None:
    motion = asked(quickening(0.0, 2.0), settle_s=0.1)
    _, stop = motion.joints.acceleration[motion.jumps]
    np.testing.assert_allclose(stop, -5.0 * SPAN / DURATION_S / TICK_S, rtol=1e-6)
    assert motion.time_s[motion.jumps].tolist() == [0.0, DURATION_S]
