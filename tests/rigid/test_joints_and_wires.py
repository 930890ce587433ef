"""Hinges, slides and wires against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.build.arms import find_arm
from cosim.config.schema.objects import WireTable
from cosim.errors import InputError
from cosim.rigid.build.description import Joint, SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene

ARM = find_arm("ur5e")
G = 9.81
POST = SceneObject("post", "box", (0.02,) * 3, (0.6, 0.6, 1.0))


def scene_of(*objects: SceneObject, wires: tuple[WireTable, ...] = (), tick_s: float = 1e-3) -> RigidScene:
    scene = RigidScene(SceneDescription(ARM, tick_s=tick_s, objects=objects, wires=wires))
    scene.set_control(scene.joint_position)
    return scene


def run(scene: RigidScene, seconds: float, *names: str) -> Array:
    """Return the positions (ticks, names, 3) [m] of bodies."""
    bodies = [scene.body_names.index(name) for name in names]
    path = []
    for _ in range(round(seconds / scene.tick_s)):
        scene.step()
        path.append(scene.body_poses()[0][bodies])
    return np.array(path)


def test_a_hinged_ball_swings_with_its_period() -> None:
    length, radius = 0.4, 0.03
    joint = Joint("hinge", (0.0, 1.0, 0.0), (0.6, 0.6, 1.0))
    angle = 0.05
    place = (0.6 + length * np.sin(angle), 0.6, 1.0 - length * np.cos(angle))
    ball = SceneObject("ball", "sphere", (radius,), place, (0.8, 0.0, 0.6, 0.0), mass_kg=0.1, joint=joint)
    x = run(scene_of(ball), 4.0, "ball")[:, 0, 0] - 0.6
    falling = np.flatnonzero((x[:-1] > 0.0) & (x[1:] <= 0.0))
    period = 2.0 * np.pi * np.sqrt((length**2 + 0.4 * radius**2) / (G * length)) * (1.0 + angle**2 / 16.0)
    assert np.diff(falling).mean() * 1e-3 == pytest.approx(period, rel=2e-3)


def test_a_slide_with_a_spring_sags_along_its_axis() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    joint = Joint("slide", tuple(axis.tolist()), damping=2.0, stiffness=20.0)
    ball = SceneObject("ball", "sphere", (0.03,), (0.6, 0.6, 1.0), mass_kg=0.1, joint=joint)
    end = run(scene_of(ball), 2.0, "ball")[-1, 0] - ball.position_m
    np.testing.assert_allclose(end, -0.1 * G * 0.8 / 20.0 * axis, atol=1e-6)


def test_limits_and_brakes_hold() -> None:
    joint = Joint("hinge", (0.0, 1.0, 0.0), (0.6, 0.6, 1.0), limits=(-0.1, 0.2), damping=1e-3)
    ball = SceneObject("ball", "sphere", (0.03,), (0.8, 0.6, 1.0), mass_kg=0.1, joint=joint)
    end = run(scene_of(ball), 2.0, "ball")[-1, 0]
    assert np.arctan2(1.0 - end[2], end[0] - 0.6) == pytest.approx(0.2, abs=0.01)
    braked = replace(ball, joint=replace(joint, friction=1.1 * 0.1 * G * 0.2))
    end = run(scene_of(braked), 2.0, "ball")[-1, 0]
    assert abs(1.0 - end[2]) < 1e-3


def test_a_chain_of_planks_hangs_from_its_parents() -> None:
    first = Joint("hinge", (0.0, 1.0, 0.0), (0.5, 0.6, 1.0), damping=8e-3)
    second = Joint("hinge", (0.0, 1.0, 0.0), (0.7, 0.6, 1.0), parent="first", damping=8e-3)
    planks = (
        SceneObject("second", "box", (0.2, 0.05, 0.01), (0.8, 0.6, 1.0), mass_kg=0.05, joint=second),
        SceneObject("first", "box", (0.2, 0.05, 0.01), (0.6, 0.6, 1.0), mass_kg=0.05, joint=first),
    )
    end = run(scene_of(*planks), 8.0, "first", "second")[-1]
    np.testing.assert_allclose(end, [[0.5, 0.6, 0.9], [0.5, 0.6, 0.7]], atol=2e-3)


def test_a_clamped_wire_bends_like_a_beam() -> None:
    length, mass, stiffness = 0.3, 0.01, 0.05
    wire = WireTable(
        "wire", ((0.6, 0.6, 1.0), (0.6 + length, 0.6, 1.0)), 2e-3, mass, 20, stiffness, 2e-3, first="post"
    )
    scene = scene_of(POST, wires=(wire,), tick_s=2e-3)
    run(scene, 1.0, "post")
    positions, quaternions = scene.body_poses()
    last = scene.body_names.index("wire/20")
    tip = Pose.from_quaternion(quaternions[last], positions[last]).apply(np.array([[0.0, 0.0, length / 20]]))
    sag = mass * G / length * length**4 / (8.0 * stiffness)
    assert 1.0 - tip[0, 2] == pytest.approx(sag, rel=0.01)


@pytest.mark.parametrize("tick_s", [1e-3, 5e-3])
def test_a_stiff_light_wire_stays_calm_at_any_tick(tick_s: float) -> None:
    wire = WireTable("wire", ((0.6, 0.6, 1.0), (0.8, 0.6, 1.0)), 2e-3, 2e-3, 20, 1.0, first="post")
    path = run(scene_of(POST, wires=(wire,), tick_s=tick_s), 0.5, "wire/20")
    assert np.abs(path - path[0]).max() < 1e-3


def test_a_bent_wire_straightens_if_told_so() -> None:
    turn = np.linspace(0.0, np.pi, 30)
    arc = tuple((0.6 + 0.1 * np.sin(a), 0.6, 1.0 + 0.1 * (1.0 - np.cos(a))) for a in turn)
    bent = WireTable("wire", arc, 2e-3, 2e-3, 16, 0.02, 2e-3, first="post")
    kept = run(scene_of(POST, wires=(bent,)), 1.0, "wire/16")
    assert np.abs(kept[-1] - kept[0]).max() < 2e-3
    straightened = run(scene_of(POST, wires=(replace(bent, straight=True),)), 1.0, "wire/16")
    length = float(bent.lengths_m[:-1].sum())
    assert straightened[-1, 0, 0] == pytest.approx(0.6 + length, rel=0.02)


def test_a_wire_tied_at_both_ends_carries_a_weight() -> None:
    weight = SceneObject("weight", "sphere", (0.02,), (0.6, 0.6, 0.68), mass_kg=0.2)
    wire = WireTable(
        "wire", ((0.6, 0.6, 1.0), (0.6, 0.6, 0.7)), 2e-3, 5e-3, 10, 0.0, 1e-5, first="post", last="weight"
    )
    path = run(scene_of(POST, weight, wires=(wire,)), 2.0, "weight")
    assert np.abs(path - path[0]).max() < 1e-3


def test_a_free_wire_lies_on_the_floor() -> None:
    wire = WireTable("wire", ((0.6, 0.6, 0.1), (0.9, 0.6, 0.15)), 3e-3, 5e-3, 12, 1e-4, 1e-5)
    end = run(scene_of(wires=(wire,), tick_s=2e-3), 1.5, *[f"wire/{k + 1}" for k in range(12)])[-1]
    assert np.abs(end[:, 2] - 3e-3).max() < 1.5e-3


def test_an_object_that_hangs_on_itself_is_refused() -> None:
    lid = SceneObject(
        "lid", "sphere", (0.1,), mass_kg=1.0, joint=Joint("slide", (0.0, 0.0, 1.0), parent="lid")
    )
    with pytest.raises(InputError, match="'lid': hang on themselves"):
        SceneDescription(ARM, objects=(lid,)).objects_by_parent()
