"""A palm on the flange: it weighs, the arm knows, and objects rest on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.app.preparation import build_simulation
from cosim.base.frames import Pose
from cosim.build.arms import find_arm
from cosim.build.scene_objects import PALM_NAME, palm_mass, palm_object
from cosim.config.loading import load_scenario
from cosim.config.schema.soft_robot import PalmTable
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.build.pair_friction import PairFriction
from cosim.rigid.scene.scene import RigidScene

PALM = PalmTable(radius_m=0.08, thickness_m=0.01, mass_kg=1.0)
SCENARIO = """
schema = 2
title = "A heavy palm is carried"
robot = "ur5e"
soft_robot = { file = "square_core", palm = { radius_m = 0.08, thickness_m = 0.01, mass_kg = 1.0 } }
model.published = true

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, 1.0] }

[[phase]]
name = "wait"
duration_s = 0.1
"""


def test_two_bodies_weigh_as_one() -> None:
    rng = np.random.default_rng(0)
    mass, places = rng.uniform(0.5, 1.5, size=9), rng.normal(size=(9, 3))
    whole = MassProperties.of(mass, places)
    joined = MassProperties.of(mass[:4], places[:4]).joined(MassProperties.of(mass[4:], places[4:]))
    assert joined.mass_kg == pytest.approx(whole.mass_kg)
    np.testing.assert_allclose(joined.center, whole.center, rtol=1e-12)
    np.testing.assert_allclose(joined.inertia, whole.inertia, rtol=1e-12, atol=1e-12)


def test_the_palms_mass_is_mujocos() -> None:
    scene = RigidScene(SceneDescription(find_arm("ur5e"), mounted=(palm_object(PALM),)))
    index = np.array([scene.body_names.index(PALM_NAME)])
    own = palm_mass(PALM)
    assert scene.bodies.masses_kg(index) == pytest.approx([own.mass_kg])
    in_flange = scene.flange_pose.inverse().apply(scene.bodies.mass_centers[index])[0]
    assert own.center == pytest.approx(in_flange, abs=1e-9)
    assert own.center == pytest.approx([0.0, 0.0, 0.005])  # in front of the flange
    scene.set_control(scene.joint_position, feedforward=scene.bias_torque)
    scene.step()
    assert scene.flange.measured[2] == pytest.approx(-9.81, rel=1e-6)


@pytest.mark.parametrize(("share", "angle"), [(0.5, 0.0), (0.9, 0.0), (0.9, 0.25 * np.pi)])
def test_an_object_rests_on_the_palm_and_stays_there(share: float, angle: float) -> None:
    arm, mounted = find_arm("ur5e"), (palm_object(PALM),)
    flange = RigidScene(SceneDescription(arm)).flange_pose
    first, second, normal = flange.rotation.T
    across = np.cos(angle) * first + np.sin(angle) * second
    place = tuple((flange.translation + 0.0155 * normal).tolist())
    coin = SceneObject("coin", "cylinder", (0.02, 0.01), place, tuple(flange.quaternion.tolist()), 0.05)
    # presses it on the palm, and along it with a share of what a friction of 0.8 holds; a pyramid instead of
    # the cone holds 0.7 of it at 45 degrees
    gravity = tuple((-9.81 * (normal + 0.8 * share * across)).tolist())
    scene = RigidScene(SceneDescription(arm, mounted=mounted, objects=(coin,), gravity=gravity))
    scene.set_control(arm.home)
    body, path = scene.body_names.index("coin"), []
    for _ in range(500):
        scene.step()
        path.append(scene.flange_pose.inverse().apply(scene.body_poses()[0][body][None])[0])
    creep = np.linalg.norm(path[-1] - path[249]) / (250 * scene.tick_s)
    assert creep < 1e-4 / 60.0  # m/s; 60 to 140 times that where friction is no harder than the normal
    assert path[-1][2] == pytest.approx(0.015, abs=1e-4)


def test_what_hardly_touches_the_palm_is_not_drawn_into_it() -> None:
    """Within MuJoCo's own tolerance of depths, 1 um, one normal in seven points the other way."""
    arm, rng, depth = find_arm("ur5e"), np.random.default_rng(0), 1e-7
    flange = RigidScene(SceneDescription(arm)).flange_pose
    pebbles = []
    for k, place in enumerate(np.ndindex(6, 6)):
        turn = Pose.from_quaternion(rng.normal(size=4), np.zeros(3)).rotation
        radii = np.array([0.003, 0.005, 0.007])
        height = 0.01 - depth + np.linalg.norm(turn[2] * radii)
        across = 0.016 * (np.array(place) - 2.5)
        pose = flange @ Pose(turn, np.array([*across, height]))
        where = tuple(pose.translation.tolist()), tuple(pose.quaternion.tolist())
        pebbles.append(SceneObject(f"pebble {k}", "ellipsoid", tuple(radii.tolist()), *where, 0.001))
    scene = RigidScene(
        SceneDescription(arm, mounted=(palm_object(PALM),), objects=tuple(pebbles), gravity=(0.0, 0.0, 0.0))
    )
    index = [scene.body_names.index(pebble.name) for pebble in pebbles]
    before = scene.body_poses()[0][index].copy()
    scene.set_control(arm.home)
    scene.step()
    moved = (scene.body_poses()[0][index] - before) @ flange.rotation[:, 2]
    assert moved.min() > -1e-10  # m in a tick; -4e-8 where a normal is reversed


@pytest.mark.parametrize("leaning", [0.0, 0.2, 0.4])
def test_a_roll_on_the_palm_lies_still(leaning: float) -> None:
    """Of its rim MuJoCo keeps four points, others in every tick, on which it walks by up to 35 um/s."""
    arm, tick_s = find_arm("ur5e"), 4e-3
    flange = RigidScene(SceneDescription(arm)).flange_pose
    across, _, normal = flange.rotation.T
    place = tuple((flange.translation + 0.0305 * normal).tolist())
    roll = SceneObject("roll", "cylinder", (0.04, 0.04), place, tuple(flange.quaternion.tolist()), 0.2)
    # four times its weight, as fingers press, and a share of it sideways
    gravity = tuple((-40.0 * normal + 40.0 * leaning * across).tolist())
    scene = RigidScene(
        SceneDescription(arm, tick_s=tick_s, mounted=(palm_object(PALM),), objects=(roll,), gravity=gravity)
    )
    body, path = scene.body_names.index("roll"), []
    for _ in range(500):
        scene.set_control(arm.home, feedforward=scene.bias_torque)
        scene.step()
        path.append(scene.flange_pose.inverse().apply(scene.body_poses()[0][body][None])[0])
    last = np.array(path[-100:])
    assert np.abs(last[-1] - last[0]).max() / (99 * tick_s) < 3e-6  # m/s; 0.7 to 1.0 here
    assert np.diff(last, axis=0).std(axis=0).max() < 3e-7  # m a tick; 0.1 here, 1.0 to 1.2 with four points


def slid_on_palm(rule: str) -> tuple[float, float]:
    """Return the speed [m/s] of a box of friction 0.8 on a palm of 0.2 and that of sliding by 0.2.

    It has its bottom on the palm, and corners that have to know of the friction as well.
    """
    arm, palm = find_arm("ur5e"), replace(PALM, friction=0.2)
    flange = RigidScene(SceneDescription(arm)).flange_pose
    across, _, normal = flange.rotation.T
    place = tuple((flange.translation + 0.0205 * normal).tolist())
    box = SceneObject("box", "box", (0.02, 0.02, 0.02), place, tuple(flange.quaternion.tolist()), 0.05)
    gravity = tuple((-9.81 * (normal - 0.4 * across)).tolist())
    scene = RigidScene(
        SceneDescription(
            arm, mounted=(palm_object(palm),), objects=(box,), gravity=gravity, friction=PairFriction(rule)
        )
    )
    body, path = scene.body_names.index("box"), []
    for _ in range(75):
        scene.set_control(arm.home, feedforward=scene.bias_torque)
        scene.step()
        path.append((scene.body_poses()[0][body] - flange.translation) @ across)
    speed = (path[-1] - path[24]) / (50 * scene.tick_s)
    return float(speed), (0.4 - 0.2) * 9.81 * 50 * scene.tick_s  # in the middle of these ticks


def test_an_object_slides_on_a_palm_by_the_friction_of_the_pair() -> None:
    speed, expected = slid_on_palm("smallest")
    assert speed == pytest.approx(expected, rel=0.05)
    assert slid_on_palm("largest")[0] < 1e-3 * expected


def _slid_m(tick_s: float, contact_time_s: float) -> float:
    """Return how far a box slides that falls by 0.2 mm on a palm whose friction can hold it."""
    arm, palm = find_arm("ur5e"), replace(PALM, contact_time_s=contact_time_s)
    flange = RigidScene(SceneDescription(arm)).flange_pose
    across, _, normal = flange.rotation.T
    place = tuple((flange.translation + 0.0207 * normal).tolist())
    box = SceneObject("box", "box", (0.02, 0.02, 0.02), place, tuple(flange.quaternion.tolist()), 0.05)
    scene = RigidScene(
        SceneDescription(
            arm, tick_s=tick_s, mounted=(palm_object(palm),), objects=(box,),
            gravity=tuple((-9.81 * (normal - 0.3 * across)).tolist()),
        )
    )  # fmt: skip
    for _ in range(round(0.2 / tick_s)):
        scene.set_control(arm.home, feedforward=scene.bias_torque)
        scene.step()
    moved = scene.body_poses()[0][scene.body_names.index("box")] - np.array(place)
    return float(moved @ across)


def test_slip_comes_from_the_contact_time_of_the_palm_not_from_the_tick() -> None:
    coarse, fine, longer = _slid_m(2e-3, 4e-3), _slid_m(0.5e-3, 4e-3), _slid_m(0.5e-3, 8e-3)
    assert coarse == pytest.approx(fine, rel=0.05)  # 1.28 times, where the time constant was four ticks
    assert longer > 1.2 * fine


def test_a_light_object_that_is_pressed_on_the_palm_does_not_sink_into_it() -> None:
    # 12 N, as a gripper's fingers press: 20 g sank by 2.4 mm
    arm = find_arm("ur5e")
    flange = RigidScene(SceneDescription(arm)).flange_pose
    normal = flange.rotation[:, 2]
    place = tuple((flange.translation + 0.0205 * normal).tolist())
    box = SceneObject("box", "box", (0.02, 0.02, 0.02), place, tuple(flange.quaternion.tolist()), 0.02)
    scene = RigidScene(
        SceneDescription(
            arm, tick_s=4e-3, mounted=(palm_object(PALM),), objects=(box,), gravity=(0.0, 0.0, 0.0)
        )
    )
    body = np.array([scene.body_names.index("box")])
    for tick in range(75):
        load = -12.0 * min(1.0, tick / 50) * scene.flange_pose.rotation[:, 2]
        scene.bodies.apply(body, load[None], np.cross(scene.body_poses()[0][body], load))
        scene.set_control(arm.home, feedforward=scene.bias_torque)
        scene.step()
    above = (scene.body_poses()[0][body[0]] - scene.flange_pose.translation) @ scene.flange_pose.rotation[
        :, 2
    ]
    assert above == pytest.approx(0.02, abs=2e-4)


def test_an_object_that_is_clamped_on_a_palm_does_not_shake_the_arm() -> None:
    """Friction on all points of its rim: MuJoCo gave up its search, and took the force as it was."""
    arm, tick_s, amplitude, rate = find_arm("ur5e"), 1e-3, 0.02, 2.0 * np.pi * 2.0
    flange = RigidScene(SceneDescription(arm)).flange_pose
    place = tuple((flange.translation + 0.0205 * flange.rotation[:, 2]).tolist())
    coin = SceneObject("coin", "cylinder", (0.036, 0.021), place, tuple(flange.quaternion.tolist()), 0.1)
    palm = palm_object(replace(PALM, mass_kg=0.1, friction=1.2))
    scene = RigidScene(
        SceneDescription(arm, tick_s=tick_s, mounted=(palm,), objects=(coin,), gravity=(0.0, 0.0, 0.0))
    )
    body, found = np.array([scene.body_names.index("coin")]), []
    way = np.array([0.0, 1.0, -1.0, 1.0, 0.0, 0.0])
    for tick in range(600):
        across, _, normal = scene.flange_pose.rotation.T
        load = -10.0 * min(1.0, tick / 200) * normal + 0.3 * across
        scene.bodies.apply(body, load[None], np.cross(scene.body_poses()[0][body], load))
        swing = rate * tick_s * max(tick - 250, 0)
        angle, speed = amplitude * (1.0 - np.cos(swing)), amplitude * rate * np.sin(swing)
        scene.set_control(arm.home + angle * way, speed * way, feedforward=scene.bias_torque)
        scene.step()
        found.append(scene.joint_acceleration.copy())
    jumps = np.abs(np.diff(found[260:], axis=0)).max()
    assert jumps < 2.0 * amplitude * rate**3 * tick_s  # rad/s^2; 1.4 times here, 33 times with 50 points


def test_an_object_goes_with_a_palm_that_is_shaken() -> None:
    """Less than half of what friction holds accelerates it; contact and servos must be solved as one."""
    arm, tick_s, rate = find_arm("ur5e"), 4e-3, 2.0 * np.pi * 4.0
    flange = RigidScene(SceneDescription(arm)).flange_pose
    normal = flange.rotation[:, 2]
    place = tuple((flange.translation + 0.0155 * normal).tolist())
    coin = SceneObject("coin", "cylinder", (0.02, 0.01), place, tuple(flange.quaternion.tolist()), 0.05)
    scene = RigidScene(
        SceneDescription(
            arm, tick_s=tick_s, mounted=(palm_object(PALM),), objects=(coin,),
            gravity=tuple((-9.81 * normal).tolist()),
        )
    )  # fmt: skip
    turn = 0.3 * 0.8 * 9.81 / (float(np.hypot(*flange.translation[:2])) * rate**2)
    body, path = scene.body_names.index("coin"), []
    for tick in range(round(0.6 / tick_s)):
        swing = max(rate * (tick * tick_s - 0.1), 0.0)
        first = np.eye(len(arm.home))[0]
        angle = turn * (1.0 - np.cos(swing))
        scene.set_control(
            arm.home + angle * first, turn * rate * np.sin(swing) * first, feedforward=scene.bias_torque
        )
        scene.step()
        path.append(scene.flange_pose.inverse().apply(scene.body_poses()[0][body][None])[0, :2])
    slide = np.linalg.norm(np.array(path) - path[round(0.1 / tick_s)], axis=1)
    assert slide.max() < 1e-4  # m; 0.8 mm where contacts are solved without the servos


def test_the_arm_knows_what_the_palm_weighs(tmp_path: Path) -> None:
    path = tmp_path / "palm.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    sags = {}
    for known in (True, False):
        simulation = build_simulation(load_scenario(path, {"payload_compensation": known}))
        snapshots = list(simulation.steps())
        assert PALM_NAME in simulation.stage.body_names
        assert any(simulation.stage.body_names[shape.body] == PALM_NAME for shape in simulation.stage.shapes)
        sags[known] = (
            snapshots[0].world_from_flange.translation[2] - snapshots[-1].world_from_flange.translation[2]
        )
    assert abs(sags[True]) < 2e-5
    assert sags[False] > 3e-4
