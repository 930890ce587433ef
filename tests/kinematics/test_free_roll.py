"""Arms with fewer joints than a pose has freedoms, and with joints that slide or turn on and on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import follow, solve
from tests.config.arm_texts import GANTRY_MJCF
from tests.derivatives import differences, relative_error

SO101, KINOVA = Arm(find_arm("so101")), Arm(find_arm("kinova"))


@pytest.mark.parametrize("near", [True, False], ids=["near", "far"])
def test_the_error_of_place_and_axis_has_its_derivative(near: bool) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        q = rng.uniform(*SO101.drawn_from)
        other = q + 0.01 * rng.normal(size=5) if near else rng.uniform(*SO101.drawn_from)
        error = SO101.error_towards(SO101.forward(other))
        by_difference = differences(lambda x, of=error: of(x)[0], q, 1e-3).T
        assert relative_error(error(q)[1], by_difference) < 1e-7  # fourth order at 1e-3 of some rad


def test_the_error_vanishes_whatever_the_roll_and_is_half_a_turn_opposite() -> None:
    q = SO101.home
    pose = SO101.forward(q)
    for angle in (0.0, 1.0, 3.0):
        rolled = Pose(pose.rotation @ rotation_from_vector(np.array([0.0, 0.0, angle])), pose.translation)
        assert np.abs(SO101.error_towards(rolled)(q)[0]).max() < 1e-12
    flipped = Pose(pose.rotation @ np.diag([1.0, -1.0, -1.0]), pose.translation)
    assert np.linalg.norm(SO101.error_towards(flipped)(q)[0][3:]) == pytest.approx(np.pi)


def test_five_joints_reach_places_and_directions() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        target = SO101.forward(rng.uniform(*SO101.drawn_from))
        found = solve(SO101, target, SO101.home)
        pose = SO101.forward(found.q)
        np.testing.assert_allclose(pose.translation, target.translation, atol=1e-6)
        np.testing.assert_allclose(pose.rotation[:, 2], target.rotation[:, 2], atol=1e-6)
        assert found.rotation_error_rad < 1e-6
        assert (found.q >= SO101.lower).all()
        assert (found.q <= SO101.upper).all()


def test_five_joints_follow_a_way_and_refuse_a_direction_out_of_their_plane() -> None:
    start = SO101.forward(SO101.home)
    up = np.array([0.0, 0.0, 0.002])
    way = [Pose(start.rotation, start.translation + k * up) for k in range(1, 11)]
    for q, target in zip(follow(SO101, way, SO101.home), way, strict=True):
        np.testing.assert_allclose(SO101.forward(q).translation, target.translation, atol=1e-6)
        np.testing.assert_allclose(SO101.forward(q).rotation[:, 2], target.rotation[:, 2], atol=1e-6)
    sideways = Pose(rotation_from_vector(np.array([0.9, 0.0, 0.0])) @ start.rotation, start.translation)
    with pytest.raises(UnreachableError, match=r"5 joints: place and direction, whatever the roll"):
        solve(SO101, sideways, SO101.home)


def test_continuous_joints_have_no_limits_and_take_the_nearest_turn() -> None:
    assert list(np.isinf(KINOVA.upper)) == [True, False, False, True, False, True]
    rng = np.random.default_rng(4)
    for _ in range(50):
        target = KINOVA.forward(rng.uniform(*KINOVA.drawn_from))
        seed = rng.uniform(*KINOVA.drawn_from) + 2.0 * np.pi * np.array([3, 0, 0, -2, 0, 1])
        q = solve(KINOVA, target, seed).q
        np.testing.assert_allclose(KINOVA.forward(q).translation, target.translation, atol=1e-6)
        np.testing.assert_allclose(KINOVA.forward(q).rotation, target.rotation, atol=2e-6)
        assert (np.abs(q - seed)[[0, 3, 5]] <= np.pi + 1e-9).all()


def test_sliding_joints_count_in_the_reach_and_are_not_turned(tmp_path: Path) -> None:
    path = tmp_path / "gantry.xml"
    path.write_text(GANTRY_MJCF)
    arm = Arm(find_arm(str(path)))
    rng = np.random.default_rng(5)
    farthest = 0.0
    for _ in range(30):
        wanted = rng.uniform(*arm.drawn_from)
        target = arm.forward(wanted)
        farthest = max(farthest, float(np.linalg.norm(target.translation - arm.shoulder)))
        q = solve(arm, target, arm.home).q
        np.testing.assert_allclose(arm.forward(q).translation, target.translation, atol=1e-6)
        assert abs(q[0]) <= 0.5
    assert farthest <= arm.reach
