"""Stepping the rigid scene: wrench, sensor, servos, redo, added armature."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cosim.base.frames import Pose, Wrench, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.config.arm_files import ArmSource
from cosim.config.arm_table import ArmTable
from cosim.errors import InstabilityError
from cosim.kinematics.arm import Arm, Payload
from cosim.rigid.build.arm_reader import read_arm
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene

FILE = find_arm("ur5e")
HOME = FILE.home
LOAD = Wrench(np.array([1.0, -2.0, -4.0]), np.array([0.3, 0.1, -0.2]))


def make_scene(**options: object) -> RigidScene:
    return RigidScene(SceneDescription(FILE, **options))


def run(scene: RigidScene, ticks: int) -> None:
    for _ in range(ticks):
        scene.step()


def test_wrench_on_the_flange_becomes_joint_torque() -> None:
    scene, unloaded = make_scene(armature=0.0), make_scene(armature=0.0)
    q = HOME + 0.2
    for each in (scene, unloaded):
        each.set_joint_state(q)
        each.set_control(q)
    scene.apply_flange_wrench(LOAD)
    for each in (scene, unloaded):
        each.step()
    difference = scene.joint_acceleration - unloaded.joint_acceleration
    expected = Arm(FILE).jacobian(q).T @ np.concatenate((LOAD.force, LOAD.torque))
    # Servos damp by the speed at the end of the step.
    felt = Arm(FILE).mass_matrix(q) + scene.tick_s * np.diag(scene.servo_damping)
    np.testing.assert_allclose(felt @ difference, expected, atol=1e-9)


def test_load_acts_at_the_flange_of_a_link_with_mass() -> None:
    """A flange frame that is itself a heavy link: the load acts at its origin, the sensor sees it alone."""
    file = read_arm(
        ArmSource(
            "forearm", FILE.path, ArmTable(FILE.path.name, flange="forearm_link", home=(0.3, -1.0, 0.5))
        )
    )
    scene, arm = RigidScene(SceneDescription(file)), Arm(file)
    torque = arm.gravity_torque(file.home) - arm.jacobian(file.home).T @ np.r_[LOAD.force, LOAD.torque]
    scene.set_control(file.home, feedforward=torque)
    scene.apply_flange_wrench(LOAD)
    run(scene, 200)
    np.testing.assert_allclose(scene.joint_position, file.home, atol=1e-10)
    np.testing.assert_allclose(scene.flange.measured[:3], LOAD.force, rtol=1e-9)
    np.testing.assert_allclose(scene.flange.measured[3:], LOAD.torque, rtol=1e-9)


def test_sensor_at_rest_reads_the_load() -> None:
    scene = make_scene()
    scene.apply_flange_wrench(LOAD)
    scene.set_control(HOME, feedforward=Arm(FILE).gravity_torque(HOME))
    run(scene, 3000)
    assert np.max(np.abs(scene.joint_velocity)) < 1e-9
    # Required: 1e-6 relative; nothing but the load hangs on the flange, so rounding alone remains.
    np.testing.assert_allclose(scene.flange.measured[:3], LOAD.force, rtol=1e-9)
    np.testing.assert_allclose(scene.flange.measured[3:], LOAD.torque, rtol=1e-9)


def test_sensor_reads_the_load_in_world_axes_while_moving() -> None:
    scene = make_scene()
    scene.set_joint_state(HOME + 0.3, np.array([1.0, -0.5, 0.8, 1.0, 2.0, 3.0]))
    scene.apply_flange_wrench(LOAD)
    run(scene, 5)
    # The flange frame itself has no mass, so the load passes it unchanged.
    np.testing.assert_allclose(scene.flange.measured[:3], LOAD.force, rtol=1e-9)
    np.testing.assert_allclose(scene.flange.measured[3:], LOAD.torque, rtol=1e-9)


def test_servo_holds_with_gravity_compensation_and_droops_without() -> None:
    arm = Arm(FILE)
    held, slack = make_scene(), make_scene()
    for scene, torque in ((held, arm.gravity_torque(HOME)), (slack, None)):
        scene.set_control(HOME, feedforward=torque)
        run(scene, 2000)
    np.testing.assert_allclose(held.joint_position, HOME, atol=1e-9)
    droop = slack.flange_pose.translation[2] - arm.forward(HOME).translation[2]
    # Weight torque over stiffness at the shoulder alone, 10.4 mm with the lighter UR5 links.
    assert -0.020 < droop < -0.005


def test_servo_tracks_velocity_and_feedforward() -> None:
    """With pos, vel and rnea feedforward, the lag stays at about one tick of motion (1.7 mrad at 2 ms)."""
    scene, arm = make_scene(), Arm(FILE)
    rate, worst = np.pi, 0.0
    for tick in range(1000):
        time = scene.tick_s * tick
        q = HOME + 0.3 * (1.0 - np.cos(rate * time)) * 0.5
        v = np.full(6, 0.15 * rate * np.sin(rate * time))
        a = np.full(6, 0.15 * rate**2 * np.cos(rate * time))
        scene.set_control(q, v, arm.inverse_dynamics(q, v, a, scene.armature))
        scene.step()
        worst = max(worst, float(np.max(np.abs(scene.joint_position - q))))
    assert worst < 0.15 * rate * scene.tick_s * 1.5


def test_payload_wrench_and_payload_feedforward_cancel_at_rest() -> None:
    arm = Arm(FILE)
    payload = Payload(0.87, np.array([0.01, 0.02, 0.25]), np.eye(3) * 1e-3)
    scene = make_scene()
    weight = np.array([0.0, 0.0, -9.81 * payload.mass_kg])
    lever = arm.forward(HOME).rotation @ payload.center_of_mass
    scene.apply_flange_wrench(Wrench(weight, np.cross(lever, weight)))
    scene.set_control(HOME, feedforward=arm.gravity_torque(HOME, payload))
    run(scene, 500)
    np.testing.assert_allclose(scene.joint_position, HOME, atol=1e-9)


def test_static_configuration_is_where_the_dynamics_settle() -> None:
    scene = make_scene()
    feedforward = Arm(FILE).gravity_torque(HOME)
    settled = scene.static_configuration(HOME, 0.5 * feedforward, LOAD)
    before = scene.joint_position
    np.testing.assert_array_equal(before, HOME)
    scene.apply_flange_wrench(LOAD)
    scene.set_control(HOME, feedforward=0.5 * feedforward)
    run(scene, 4000)
    np.testing.assert_allclose(settled, scene.joint_position, atol=1e-8)
    assert np.max(np.abs(settled - HOME)) > 1e-3


def test_redo_from_a_saved_state_is_bit_identical() -> None:
    box = SceneObject("box", "box", (0.1, 0.1, 0.1), (0.5, 0.5, 0.06), mass_kg=0.2)
    scene = make_scene(objects=(box,))
    run(scene, 20)  # the box is about to land: contacts and warm starts are part of the state
    scene.bodies.carried.carry_on_arm(np.full((6, 6), 0.01) + np.diag(np.full(6, 0.05)))
    scene.apply_flange_wrench(LOAD)
    state = scene.state

    def record() -> list[np.ndarray]:
        run(scene, 50)
        positions, quaternions = scene.body_poses()
        return [
            positions, quaternions, scene.joint_velocity, scene.joint_acceleration, scene.flange.measured
        ]  # fmt: skip

    first = record()
    scene.bodies.carried.carry_on_arm(np.diag(np.full(6, 3.0)))
    scene.apply_flange_wrench(Wrench())
    run(scene, 3)
    scene.state = state
    for a, b in zip(first, record(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_restored_state_is_readable_at_once() -> None:
    scene = make_scene()
    scene.apply_flange_wrench(LOAD)
    run(scene, 10)
    state, q, a = scene.state, scene.joint_position, scene.joint_acceleration
    position, sensor = scene.flange_pose.translation, scene.flange.measured[:3]
    run(scene, 10)
    scene.state = state
    np.testing.assert_array_equal(scene.joint_position, q)
    np.testing.assert_array_equal(scene.joint_acceleration, a)
    np.testing.assert_array_equal(scene.flange_pose.translation, position)
    np.testing.assert_array_equal(scene.flange.measured[:3], sensor)


def test_carried_inertia_acts_in_the_step_in_progress() -> None:
    plain, heavy = make_scene(), make_scene()
    half = np.random.default_rng(0).normal(size=(6, 6))
    extra = half @ half.T
    heavy.bodies.carried.carry_on_arm(extra)
    np.testing.assert_allclose(heavy.mass_matrix - plain.mass_matrix, extra, atol=1e-12)
    light, loaded = plain.mass_matrix, heavy.mass_matrix
    for scene in (plain, heavy):
        scene.set_control(HOME)
        scene.step()
    # The same torques act on both, so (M + h K) a is the same.
    damping = plain.tick_s * np.diag(plain.servo_damping)
    torque = (light + damping) @ plain.joint_acceleration
    np.testing.assert_allclose((loaded + damping) @ heavy.joint_acceleration, torque, atol=1e-9)
    heavy.bodies.carried.carry_on_arm(np.zeros((6, 6)))
    heavy.state = heavy.state
    plain.set_joint_state(heavy.joint_position)
    np.testing.assert_allclose(heavy.mass_matrix, plain.mass_matrix, atol=1e-12)


def test_joint_torque_is_added_to_the_servos() -> None:
    scene, plain = make_scene(), make_scene()
    torque = np.array([1.0, -2.0, 3.0, 0.4, -0.5, 0.6])
    scene.apply_joint_torque(torque)
    felt = scene.mass_matrix + scene.tick_s * np.diag(scene.servo_damping)
    for each in (scene, plain):
        each.step()
    difference = scene.joint_acceleration - plain.joint_acceleration
    np.testing.assert_allclose(felt @ difference, torque, atol=1e-9)


def test_mobility_is_the_flange_velocity_change_of_an_impulse() -> None:
    """One tick under a load, against the same tick without it: dv = W load h."""
    scene, plain = make_scene(), make_scene()
    load = 1e-3 * LOAD.force
    mobility = scene.mobility()
    np.testing.assert_allclose(mobility, mobility.T, atol=1e-12)
    scene.apply_flange_wrench(Wrench(load, np.zeros(3)))
    for each in (scene, plain):
        run(each, 1)
    change = scene.flange_twist.linear - plain.flange_twist.linear
    # Gravity moves the arm a little in the tick, which turns the Jacobian by about 1e-4.
    np.testing.assert_allclose(change, mobility[:3, :3] @ load * scene.tick_s, rtol=2e-3)


def test_effort_limits_are_respected() -> None:
    scene = make_scene()
    scene.set_control(HOME + 1.0, feedforward=np.full(6, 1e4))
    scene.step()
    np.testing.assert_allclose(scene.servo_torque, [150, 150, 150, 28, 28, 28])


def test_a_step_is_that_of_mujoco() -> None:
    """Where no servo is at its limit: the same state and sensors, bit for bit, with and without contacts."""
    ball = SceneObject("ball", "sphere", (0.05,), (0.6, 0.6, 0.06), mass_kg=0.1)
    scene, other = make_scene(objects=(ball,)), make_scene(objects=(ball,))
    for each in (scene, other):
        each.set_control(HOME + 0.05)
        each.apply_flange_wrench(LOAD)
    for _ in range(100):
        scene.step()
        mujoco.mj_step2(other._model, other._data)
        other.begin_step()
        for name in ("time", "qpos", "qvel", "qacc", "qacc_warmstart", "sensordata"):
            np.testing.assert_array_equal(getattr(scene._data, name), getattr(other._data, name), name)


def test_arm_stands_on_its_base() -> None:
    base = Pose(rotation_from_vector(np.array([0.0, 0.0, 0.5 * np.pi])), np.array([0.2, 0.3, 0.4]))
    scene = make_scene(world_from_base=base)
    expected = base @ Arm(FILE).forward(HOME)
    np.testing.assert_allclose(scene.flange_pose.translation, expected.translation, atol=1e-12)
    np.testing.assert_allclose(scene.flange_pose.rotation, expected.rotation, atol=1e-12)


def test_free_object_falls_onto_the_floor_and_stays() -> None:
    ball = SceneObject("ball", "sphere", (0.05,), (0.6, 0.6, 0.2), mass_kg=0.1)
    scene = make_scene(objects=(ball,))
    run(scene, 1000)
    height = scene.body_poses()[0][scene.body_names.index("ball"), 2]
    assert 0.048 < height < 0.0501  # MuJoCo's contacts give way by about a tenth of a millimetre


def test_arm_does_not_collide_with_itself_but_with_objects() -> None:
    # Folded onto itself, the arm must not be pushed apart.
    folded = np.array([0.0, -1.5, 3.0, 0.0, 0.0, 0.0])
    scene = make_scene(floor_height_m=None, gravity=(0.0, 0.0, 0.0))
    scene.set_joint_state(folded)
    scene.set_control(folded)
    run(scene, 10)
    np.testing.assert_allclose(scene.joint_position, folded, atol=1e-12)
    obstacle = SceneObject("block", "box", (0.02, 0.02, 0.02), tuple(scene.flange_pose.translation))
    blocked = make_scene(floor_height_m=None, gravity=(0.0, 0.0, 0.0), objects=(obstacle,))
    blocked.set_joint_state(folded)
    blocked.set_control(folded)
    run(blocked, 10)
    assert np.max(np.abs(blocked.joint_position - folded)) > 1e-4


def test_runaway_state_is_named_and_can_be_left() -> None:
    scene = make_scene()
    state = scene.state
    scene.apply_flange_wrench(Wrench(np.array([np.nan, 0.0, 0.0]), np.zeros(3)))
    with pytest.raises(InstabilityError, match=r"the rigid scene became unstable at 0\.\d+ s"):
        scene.step()
    scene.state = state
    run(scene, 5)
    assert np.all(np.isfinite(scene.joint_position))
