"""MuJoCo and Pinocchio must see one and the same arm; 1e-9 leaves six digits above rounding."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from cosim.base.frames import Pose, Wrench, rotation_from_vector
from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm, Payload
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

BASE = Pose(rotation_from_vector(np.array([0.4, -0.2, 0.9])), np.array([0.3, -0.1, 0.5]))


def scene_and_arm(name: str, **options: object) -> tuple[RigidScene, Arm]:
    file = find_arm(name)
    # No floor: a random pose may reach below it, and contact forces are not the subject.
    scene = RigidScene(SceneDescription(file, world_from_base=BASE, floor_height_m=None, **options))
    return scene, Arm(file, BASE)


@pytest.mark.parametrize(("name", "states"), [(n, 1000 if n == "ur5e" else 50) for n in list_arms()])
def test_poses_jacobians_and_dynamics(name: str, states: int) -> None:
    scene, arm = scene_and_arm(name, armature=0.0)
    rng = np.random.default_rng(1)
    for _ in range(states):
        q, v = rng.uniform(*arm.drawn_from), rng.normal(size=arm.joint_count)
        scene.set_joint_state(q, v)
        pose, jacobian, mass = arm.forward(q), arm.jacobian(q), arm.mass_matrix(q)
        np.testing.assert_allclose(scene.flange_pose.translation, pose.translation, atol=1e-9)
        np.testing.assert_allclose(scene.flange_pose.rotation, pose.rotation, atol=1e-9)
        np.testing.assert_allclose(scene.flange.jacobian(), jacobian, atol=1e-9)
        twist = np.concatenate((scene.flange_twist.linear, scene.flange_twist.angular))
        np.testing.assert_allclose(twist, jacobian @ v, atol=1e-9)
        np.testing.assert_allclose(scene.mass_matrix, mass, atol=1e-9 * np.abs(mass).max())
        bias = arm.inverse_dynamics(q, v, np.zeros_like(q)) - arm.friction(v)
        np.testing.assert_allclose(scene.bias_torque, bias, atol=1e-9 * np.abs(bias).max())
        scene.set_joint_state(q)
        gravity = arm.gravity_torque(q)
        np.testing.assert_allclose(scene.bias_torque, gravity, atol=1e-9 * np.abs(gravity).max())


def test_ur5e_tool_at_zero_angles() -> None:
    # The published check of the maker's joint frames.
    arm = Arm(find_arm("ur5e"))
    np.testing.assert_allclose(arm.forward(np.zeros(6)).translation, [0.8172, 0.2329, 0.0628], atol=1e-9)


def test_ur5e_masses_and_limits() -> None:
    file = find_arm("ur5e")
    arm = Arm(file)
    masses = [float(m.get("value", "nan")) for m in ElementTree.fromstring(file.urdf).iter("mass")]
    np.testing.assert_allclose(sum(masses), 4.0 + 17.700, atol=1e-9)  # published: base, six moving links
    np.testing.assert_allclose(arm.effort_limit, [150, 150, 150, 28, 28, 28])
    np.testing.assert_allclose(arm.velocity_limit, np.pi)
    np.testing.assert_allclose(arm.upper, np.pi * np.array([2, 2, 1, 2, 2, 2]))
    np.testing.assert_allclose(arm.lower, -arm.upper)


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_feedforward_gives_the_wanted_acceleration_with_armature_and_payload(name: str) -> None:
    """The payload's wrench on the flange, with rnea's torque, must reproduce the acceleration."""
    scene, arm = scene_and_arm(name, armature=0.1, tick_s=1e-9)
    rng = np.random.default_rng(2)
    payload = Payload(0.35, np.array([0.02, -0.03, 0.15]), np.diag([2e-3, 3e-3, 1e-3]))
    for _ in range(50):
        # Away from joint limits, which would push back.
        q = arm.home + rng.uniform(-0.3, 0.3, arm.joint_count)
        v, a = rng.normal(size=(2, arm.joint_count)) * 0.2
        torque = arm.inverse_dynamics(q, v, a, scene.armature, payload)
        bare = arm.inverse_dynamics(q, v, a, scene.armature)
        # The joint torques that the payload asks for are those of its reaction on the flange.
        force = _payload_reaction(arm, payload, q, v, a)
        np.testing.assert_allclose(
            torque - bare,
            -arm.jacobian(q).T @ np.concatenate((force.force, force.torque)),
            atol=1e-6,  # N m; the reaction's acceleration is a central difference
        )
        scene.set_joint_state(q, v)
        scene.apply_flange_wrench(force)
        # As applied torque, not through the servos, whose limits would cut the panda's wrist off.
        scene.set_control(q, v)
        scene.apply_joint_torque(torque)
        scene.step()
        np.testing.assert_allclose(scene.joint_acceleration, a, atol=1e-5)


def _payload_reaction(arm: Arm, payload: Payload, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Wrench:
    """Newton's and Euler's laws for the payload: what it exerts on the flange, at the flange origin."""
    step = 1e-4

    def spatial_velocity(time: float) -> np.ndarray:
        at = q + time * v + 0.5 * time**2 * a
        return arm.jacobian(at) @ (v + time * a)

    rate = (spatial_velocity(step) - spatial_velocity(-step)) / (2.0 * step)
    omega = spatial_velocity(0.0)[3:]
    rotation = arm.forward(q).rotation
    lever, inertia = rotation @ payload.center_of_mass, rotation @ payload.inertia @ rotation.T
    acceleration = rate[:3] + np.cross(rate[3:], lever) + np.cross(omega, np.cross(omega, lever))
    force = payload.mass_kg * (acceleration - np.array([0.0, 0.0, -9.81]))
    spin = inertia @ rate[3:] + np.cross(omega, inertia @ omega)
    return Wrench(-force, -spin - np.cross(lever, force))
