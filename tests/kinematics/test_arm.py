"""The arm's kinematics against finite differences, and its guards."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Pose, rotation_from_vector, vector_from_rotation
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm, Payload

ARM = Arm(find_arm("ur5e"))
Q = np.array([0.3, -1.2, 1.1, -0.7, 0.9, 2.0])
TARGET = Pose(rotation_from_vector(np.array([0.4, -1.0, 0.2])), np.array([0.4, 0.2, 0.5]))


def central(function, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    return np.stack(
        [(function(q + step * e) - function(q - step * e)) / (2 * step) for e in np.eye(len(q))], axis=-1
    )


def test_jacobian_is_the_derivative_of_the_pose() -> None:
    # Central differences of step 1e-6 are good to about 1e-10.
    jacobian, rotation = ARM.jacobian(Q), ARM.forward(Q).rotation
    position = central(lambda q: ARM.forward(q).translation, Q)
    turn = central(lambda q: vector_from_rotation(ARM.forward(q).rotation @ rotation.T), Q)
    np.testing.assert_allclose(jacobian[:3], position, atol=1e-8)
    np.testing.assert_allclose(jacobian[3:], turn, atol=1e-8)


def test_pose_error_has_the_exact_derivative_and_vanishes_at_the_target() -> None:
    error = ARM.error_towards(TARGET)
    np.testing.assert_allclose(error(Q)[1], central(lambda q: error(q)[0], Q), atol=1e-8)
    np.testing.assert_allclose(ARM.error_towards(ARM.forward(Q))(Q)[0], 0.0, atol=1e-14)


def test_gravity_torque_is_the_gradient_of_the_potential() -> None:
    # With the same payload lumped at the flange origin the difference is its weight times J.
    payload = Payload(2.0, np.zeros(3), np.zeros((3, 3)))
    difference = ARM.gravity_torque(Q, payload) - ARM.gravity_torque(Q)
    np.testing.assert_allclose(difference, 2.0 * 9.81 * ARM.jacobian(Q)[2], atol=1e-12)


def test_armature_adds_to_the_inertia_of_each_joint() -> None:
    a, zero = np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0]), np.zeros(6)
    armature = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    extra = ARM.inverse_dynamics(Q, zero, a, armature) - ARM.inverse_dynamics(Q, zero, a)
    np.testing.assert_allclose(extra, armature * a, atol=1e-12)
    np.testing.assert_allclose(
        ARM.inverse_dynamics(Q, zero, a) - ARM.gravity_torque(Q), ARM.mass_matrix(Q) @ a, atol=1e-12
    )


def test_payload_is_forgotten_when_not_given() -> None:
    bare = ARM.gravity_torque(Q)
    ARM.gravity_torque(Q, Payload(5.0, np.array([0.0, 0.0, 0.3]), np.eye(3)))
    np.testing.assert_array_equal(ARM.gravity_torque(Q), bare)


def test_gravity_can_be_switched_off_and_turned() -> None:
    np.testing.assert_array_equal(Arm(find_arm("ur5e"), gravity=(0, 0, 0)).gravity_torque(Q), np.zeros(6))
    upside_down = Arm(find_arm("ur5e"), gravity=(0, 0, 9.81))
    np.testing.assert_allclose(upside_down.gravity_torque(Q), -ARM.gravity_torque(Q), atol=1e-12)


def test_no_configuration_exceeds_the_reach() -> None:
    rng = np.random.default_rng(0)
    distances = [
        np.linalg.norm(ARM.forward(rng.uniform(ARM.lower, ARM.upper)).translation - ARM.shoulder)
        for _ in range(500)
    ]
    # 0.425 + 0.3922, then the three wrist offsets at right angles; 1.039 m bounds, 0.95 m is attained.
    assert 0.7 < max(distances) <= ARM.reach
