"""Inverse kinematics: reaches what is reachable, names what is not, stays near the seed."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_quaternion, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import follow, solve

UR5E = Arm(find_arm("ur5e"))
PANDA = Arm(find_arm("panda"))
HOME = UR5E.home


def assert_reached(arm: Arm, q: np.ndarray, target: Pose) -> None:
    pose = arm.forward(q)
    assert np.linalg.norm(pose.translation - target.translation) < 1e-6
    assert np.linalg.norm(pose.rotation - target.rotation) < 2e-6  # Frobenius norm: sqrt(2) times the angle
    assert np.all(q >= arm.lower)
    assert np.all(q <= arm.upper)


@pytest.mark.parametrize(("arm", "count"), [(UR5E, 300), (PANDA, 50)], ids=["ur5e", "panda"])
def test_random_reachable_poses_from_random_starts(arm: Arm, count: int) -> None:
    rng = np.random.default_rng(5)
    for _ in range(count):
        target = arm.forward(rng.uniform(*arm.drawn_from))
        seed = rng.uniform(*arm.drawn_from)
        solution = solve(arm, target, seed)
        for turn in (-2.0 * np.pi, 2.0 * np.pi):
            other = solution.q + turn  # no joint may be nearer to the seed a full turn away
            allowed = (other >= arm.lower) & (other <= arm.upper)
            assert not np.any(allowed & (np.abs(other - seed) < np.abs(solution.q - seed)))
        assert_reached(arm, solution.q, target)
        assert solution.position_error_m < 1e-6
        assert solution.rotation_error_rad < 1e-6


def test_unreachable_poses_are_named_with_the_closest_found() -> None:
    rng = np.random.default_rng(6)
    for k in range(20):
        rotation = rotation_from_quaternion(rng.normal(size=4))
        if k % 2:  # beyond the reach
            direction = rng.normal(size=3)
            distance = UR5E.reach * rng.uniform(1.001, 1.5)
            position = UR5E.shoulder + distance * direction / np.linalg.norm(direction)
        else:  # the wrist centre inside the cylinder (radius 0.1333 m) that the wrist offset keeps free
            angle, radius = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 0.12)
            centre = np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.3, 0.8)])
            position = centre + 0.0996 * rotation[:, 2]
        with pytest.raises(UnreachableError, match="the closest pose found is") as caught:
            solve(UR5E, Pose(rotation, position), HOME, restarts=30)
        assert isinstance(caught.value.closest, Pose)


def test_closest_pose_of_a_target_straight_above_is_the_stretched_arm() -> None:
    q = np.array([0.0, -0.5 * np.pi, 0.0, -0.5 * np.pi, 0.0, 0.0])
    top = UR5E.forward(q)
    target = Pose(top.rotation, top.translation + np.array([0.0, 0.0, 0.2]))
    with pytest.raises(UnreachableError, match=r"within the joint limits|the arm's reach is") as caught:
        solve(UR5E, target, q + 0.1)
    missing = np.linalg.norm(caught.value.closest.translation - target.translation)
    # Error in position and rotation is weighed as 1 m to 1 rad, so the arm leans only a little.
    assert 0.15 < missing < 0.21


def test_solution_near_the_seed_is_the_near_one() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        q = HOME + rng.uniform(-0.3, 0.3, 6)
        solution = solve(UR5E, UR5E.forward(q), HOME)
        np.testing.assert_allclose(solution.q, q, atol=1e-6)
        assert solution.restarts == 0


def test_full_turns_are_taken_off_towards_the_seed() -> None:
    target = UR5E.forward(HOME)
    for turn in (-1.0, 1.0):
        seed = HOME + np.array([0.0, 0.0, 0.0, 0.0, 0.0, turn * 2.0 * np.pi])
        np.testing.assert_allclose(solve(UR5E, target, seed).q, seed, atol=1e-6)


def test_equal_seeds_give_equal_solutions() -> None:
    rng = np.random.default_rng(8)
    target, seed = UR5E.forward(rng.uniform(-np.pi, np.pi, 6)), rng.uniform(-np.pi, np.pi, 6)
    np.testing.assert_array_equal(solve(UR5E, target, seed).q, solve(UR5E, target, seed).q)


def test_a_path_is_followed_without_leaving_the_branch() -> None:
    start = UR5E.forward(HOME)
    path = [
        Pose(rotation_from_vector(np.array([0.0, s, 0.0])) @ start.rotation, start.translation)
        for s in np.linspace(0.0, 0.28 * np.pi, 60)
    ]
    configurations = follow(UR5E, path, HOME)
    for q, target in zip(configurations, path, strict=True):
        assert_reached(UR5E, q, target)
    assert np.max(np.abs(np.diff(configurations, axis=0))) < 0.1
    np.testing.assert_allclose(configurations[0], HOME, atol=1e-6)


def test_a_path_that_ends_is_named() -> None:
    start = UR5E.forward(HOME)
    path = [
        Pose(start.rotation, start.translation + np.array([x, 0.0, 0.0])) for x in np.linspace(0, 1.0, 40)
    ]
    with pytest.raises(UnreachableError, match=r"pose \d+ of the path"):
        follow(UR5E, path, HOME)


def test_a_jump_is_refused() -> None:
    far = UR5E.forward(HOME + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(UnreachableError, match="joint shoulder_pan_joint would have to go from"):
        follow(UR5E, [far], HOME)
