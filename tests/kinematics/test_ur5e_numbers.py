"""The UR5e file against the maker's published tables, by a third and independent calculation.

MuJoCo and Pinocchio read the same file, so their agreement cannot show a wrong number in it.
"""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm

HALF = 0.5 * np.pi
# Joint frames in the parent link: x, y, z [m], roll, pitch, yaw [rad]; axis +z.
JOINTS = [
    (0, 0, 0.1625, 0, 0, 0),
    (0, 0, 0, HALF, 0, 0),
    (-0.425, 0, 0, 0, 0, 0),
    (-0.3922, 0, 0.1333, 0, 0, 0),
    (0, -0.0997, 0, HALF, 0, 0),
    (0, 0.0996, 0, HALF, np.pi, np.pi),
]
# Mass [kg], centre of mass [m], pitch of the tensor's frame [rad], ixx, iyy, izz [kg m^2].
LINKS = [
    (3.761, (0, -0.00193, -0.02561), 0, (0.0102675, 0.0102675, 0.00666)),
    (8.058, (-0.2125, 0, 0.11336), HALF, (0.13388583541666665, 0.13388583541666665, 0.0151074)),
    (2.846, (-0.2422, 0, 0.0265), HALF, (0.03120936758333333, 0.03120936758333333, 0.004095)),
    (1.37, (0, -0.01634, -0.0018), 0, (0.0025599, 0.0025599, 0.0021942)),
    (1.3, (0, 0.01634, -0.0018), 0, (0.0025599, 0.0025599, 0.0021942)),
    (0.365, (0, 0, -0.001159), 0, (9.890414008333333e-05, 9.890414008333333e-05, 1.321171875e-04)),
]


def turn(axis: int, angle: float) -> np.ndarray:
    return rotation_from_vector(angle * np.eye(3)[axis])


def link_poses(q: np.ndarray) -> list[Pose]:
    pose, poses = Pose(turn(2, np.pi)), []
    for (x, y, z, roll, pitch, yaw), angle in zip(JOINTS, q, strict=True):
        rotation = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
        pose = pose @ Pose(rotation, np.array([x, y, z])) @ Pose(turn(2, angle))
        poses.append(pose)
    return poses


def mass_matrix_and_gravity(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum over links of m Jv'Jv + Jw' I Jw and of -m g' Jv."""
    poses = link_poses(q)
    axes = np.stack([pose.rotation[:, 2] for pose in poses], axis=1)
    mass_matrix, gravity = np.zeros((6, 6)), np.zeros(6)
    for link, (mass, centre, pitch, diagonal) in enumerate(LINKS):
        world_centre = poses[link].apply(np.array(centre))
        moves = np.arange(6) <= link
        angular = axes * moves
        linear = np.stack(
            [np.cross(axes[:, j], world_centre - poses[j].translation) * moves[j] for j in range(6)], axis=1
        )
        tensor_axes = poses[link].rotation @ turn(1, pitch)
        tensor = tensor_axes @ np.diag(diagonal) @ tensor_axes.T
        mass_matrix += mass * linear.T @ linear + angular.T @ tensor @ angular
        gravity += mass * 9.81 * linear[2]
    return mass_matrix, gravity


def test_file_holds_the_published_numbers() -> None:
    arm, rng = Arm(find_arm("ur5e")), np.random.default_rng(4)
    for _ in range(20):
        q = rng.uniform(-np.pi, np.pi, 6)
        mass_matrix, gravity = mass_matrix_and_gravity(q)
        # The maker's frames carry angles rounded to 1e-9 rad and offsets of 2e-11 m, left out here.
        np.testing.assert_allclose(arm.mass_matrix(q), mass_matrix, atol=1e-7)
        np.testing.assert_allclose(arm.gravity_torque(q), gravity, atol=1e-6)
        np.testing.assert_allclose(arm.forward(q).translation, link_poses(q)[-1].translation, atol=1e-8)
        np.testing.assert_allclose(arm.forward(q).rotation, link_poses(q)[-1].rotation, atol=1e-8)
