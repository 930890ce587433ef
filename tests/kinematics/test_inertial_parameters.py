"""Inertial parameters, and the joint torques that are linear in them."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm, Payload
from cosim.kinematics.inertial_parameters import change_of_frame, inertial_parameters

SEEDS = range(3)


def cloud(seed: int) -> tuple[Array, Array]:
    """Return masses (n,) and places (n, 3)."""
    random = np.random.default_rng(seed)
    return random.uniform(0.1, 1.0, 7), random.normal(size=(7, 3))


def parameters_of(mass: Array, places: Array) -> Array:
    """Return the parameters of points, by their definition."""
    total = mass.sum()
    center = mass @ places / total
    arm = places - center
    inertia = sum(m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(mass, arm, strict=True))
    return inertial_parameters(float(total), center, np.asarray(inertia))


@pytest.mark.parametrize("seed", SEEDS)
def test_points_give_their_sums(seed: int) -> None:
    mass, places = cloud(seed)
    x, y, z = places.T
    expected = [
        mass.sum(), mass @ x, mass @ y, mass @ z, mass @ (y * y + z * z), -mass @ (x * y),
        mass @ (x * x + z * z), -mass @ (x * z), -mass @ (y * z), mass @ (x * x + y * y),
    ]  # fmt: skip
    np.testing.assert_allclose(parameters_of(mass, places), expected, atol=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_change_of_frame_moves_the_points(seed: int) -> None:
    mass, places = cloud(seed)
    pose = Pose(rotation_from_vector(np.array([0.4, -1.1, 0.7])), np.array([0.3, 0.5, -0.2]))
    moved = change_of_frame(pose) @ parameters_of(mass, places)
    np.testing.assert_allclose(moved, parameters_of(mass, pose.apply(places)), atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_torques_are_those_of_inverse_dynamics_with_a_payload(seed: int) -> None:
    """Both are Pinocchio's: the one with the payload in the last link, the other by its regressor."""
    random = np.random.default_rng(seed)
    arm, armature = Arm(find_arm("ur5e"), gravity=(1.0, -2.0, -9.0)), random.uniform(0.1, 0.3, 6)
    q, velocity, acceleration = random.normal(size=(3, 5, 6))
    mass, places = cloud(seed)
    load = parameters_of(mass, places)
    center = load[1:4] / load[0]
    arms = places - center
    inertia = np.asarray(
        sum(m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(mass, arms, strict=True))
    )
    payload = Payload(float(load[0]), center, inertia)
    rows = zip(q, velocity, acceleration, strict=True)
    expected = np.array([arm.inverse_dynamics(*row, armature, payload) for row in rows])
    bare, by_payload = arm.torque_rows(q, velocity, acceleration, armature)
    np.testing.assert_allclose(bare + by_payload @ load, expected, rtol=1e-12, atol=1e-11)
