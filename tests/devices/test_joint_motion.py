"""How a commanded twist becomes a motion of the joints."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import rotation_from_vector
from cosim.build.arms import find_arm
from cosim.devices.live.joint_motion import Departure, JointMotion
from cosim.kinematics.arm import Arm
from cosim.plan.arm_limits import ArmLimits

TICK_s = 0.004
HERE = np.array([0.3, -1.4, 1.5, -1.7, -1.5, 0.2])


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(find_arm("ur5e"))


def test_a_twist_takes_the_flange_straight_and_turns_it_evenly(arm: Arm) -> None:
    twist, ticks = np.array([0.1, -0.05, 0.08, 0.2, -0.3, 0.1]), 125
    motion = Departure(HERE, 0, ticks, ArmLimits.of(arm), TICK_s).along(arm, twist)
    begin, end, lasts_s = arm.forward(HERE), arm.forward(motion.knots[-1]), ticks * TICK_s
    # of pieces of 0.01 rad the middle's rate leaves a millionth of the way, the first one's 100 times as much
    np.testing.assert_allclose(end.translation, begin.translation + lasts_s * twist[:3], atol=2e-6)
    turned = rotation_from_vector(lasts_s * twist[3:]) @ begin.rotation
    np.testing.assert_allclose(end.rotation, turned, atol=1e-5)
    assert motion.limits == ()


def test_a_twist_that_is_too_fast_is_followed_at_the_fastest_joints_bound(arm: Arm) -> None:
    limits, ticks = ArmLimits.of(arm), 5
    motion = Departure(HERE, 0, ticks, limits, TICK_s).along(arm, np.array([8.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    speed = np.abs(motion.through(0, ticks, TICK_s).velocity) / limits.velocity
    assert speed.max(axis=1) == pytest.approx(1.0)
    begin, end = arm.forward(HERE).translation, arm.forward(motion.knots[-1]).translation
    # slower, not elsewhere: a piece's rate is that of its middle at the speed that was asked for
    np.testing.assert_allclose((end - begin)[1:], 0.0, atol=1e-2 * (end - begin)[0])
    assert any("speed of" in text for text in motion.limits)


def test_a_cubic_leaves_and_arrives_with_its_speeds() -> None:
    random, ticks = np.random.default_rng(2), 40
    knots, speeds = random.normal(size=(2, 3)), random.normal(size=(2, 3))
    motion = JointMotion(7, ticks, knots, speed=speeds)
    found = motion.through(7, ticks + 3, TICK_s)
    np.testing.assert_allclose(found.position[[0, ticks]], knots, atol=1e-14)
    np.testing.assert_allclose(found.velocity[0], speeds[0])
    np.testing.assert_allclose(motion.speed_at(7 + ticks, TICK_s), speeds[1])
    assert not found.velocity[ticks:].any()  # it stands there, unless another motion follows
    assert not found.acceleration[ticks:].any()
    # central differences of a cubic are off by its third derivative, which is constant
    place, inner = found.position[: ticks + 1], slice(1, ticks)
    third = np.diff(place, 3, axis=0)[0] / TICK_s**3
    speed = (place[2:] - place[:-2]) / (2.0 * TICK_s) - third * TICK_s**2 / 6.0
    np.testing.assert_allclose(found.velocity[inner], speed, atol=1e-9)
    bend = np.diff(place, 2, axis=0) / TICK_s**2
    np.testing.assert_allclose(found.acceleration[inner], bend, atol=1e-6)
