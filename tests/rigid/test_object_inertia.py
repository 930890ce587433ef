"""Objects with an inertia of their own, and with friction against turning and rolling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.arms import find_arm
from cosim.build.scene_objects import rigid_object
from cosim.config.loading import load_scenario
from cosim.rigid.build.description import Joint, SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene

ARM = find_arm("ur5e")


def test_a_given_inertia_answers_torques() -> None:
    """About the hinge it is I_zz + m c^2; the moment is constant, the axis vertical."""
    item = SceneObject(
        "arm", "box", (0.1, 0.1, 0.1), (1.0, 1.0, 1.0), mass_kg=2.0,
        joint=Joint("hinge", (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)), inertia=(0.02, 0.02, 0.01),
        center_of_mass_m=(0.1, 0.0, 0.0),
    )  # fmt: skip
    scene = RigidScene(SceneDescription(ARM, objects=(item,), tick_s=1e-3))
    body = np.array([scene.body_names.index("arm")])
    for _ in range(100):
        scene.bodies.apply(body, np.zeros((1, 3)), np.array([[0.0, 0.0, 0.3]]))
        scene.step()
    turned = 2.0 * np.arcsin(scene.body_poses()[1][body[0], 3])
    # steps of 1 ms end half a step further than 0.5 a t^2
    assert turned == pytest.approx(0.5 * 0.3 / 0.03 * 0.1**2 * (1.0 + 1.0 / 100.0), rel=1e-6)


@pytest.mark.parametrize(("friction", "rolls"), [(None, True), ((0.0, 0.01), False)])
def test_rolling_friction_holds_a_ball_on_a_slope(friction: tuple[float, float] | None, rolls: bool) -> None:
    """It holds up to a slope of friction / radius = 0.2; the slope is 0.1."""
    ball = SceneObject("ball", "sphere", (0.05,), (1.0, 0.0, 0.05), mass_kg=0.2, spin_friction_m=friction)
    scene = RigidScene(SceneDescription(ARM, objects=(ball,), gravity=(0.981, 0.0, -9.81)))
    start = scene.body_poses()[0][-1, 0]
    for _ in range(250):
        scene.step()
    gone = scene.body_poses()[0][-1, 0] - start
    free = 0.5 * 5.0 / 7.0 * 0.981 * 0.5**2  # a solid ball rolls down with 5/7 of the acceleration
    if rolls:
        assert gone == pytest.approx(free, rel=0.02)
    else:
        assert gone < 0.3 * free  # MuJoCo's friction creeps


ENTRY = {"name": "a", "shape": "box", "size_m": [0.1, 0.1, 0.1], "position_m": [1.0, 0.0, 0.05]}


def loaded(**keys: Any) -> cosim.config.schema.scenario.Scenario:
    return load_scenario("ur5e_hexagon_arm", {"object": [ENTRY | keys]})


def test_keys_of_a_scenario_reach_the_scene() -> None:
    scenario = loaded(
        mass_kg=1.0, inertia_kg_m2=[0.02, 0.03, 0.04], center_of_mass_m=[0.0, 0.0, -0.01],
        rolling_friction_m=1e-3,
    )  # fmt: skip
    item = rigid_object(scenario.objects[0])
    assert (item.inertia, item.center_of_mass_m) == ((0.02, 0.03, 0.04), (0.0, 0.0, -0.01))
    assert item.spin_friction_m == (0.0, 1e-3)
    assert rigid_object(loaded().objects[0]).spin_friction_m is None


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"inertia_kg_m2": [1.0, 1.0, 1.0]}, r"object\.a\.mass_kg: is missing"),
        ({"mass_kg": 1.0, "center_of_mass_m": [0.0, 0.0, 0.0]}, r"center_of_mass_m: goes with inertia_kg_m2"),
        ({"mass_kg": 1.0, "inertia_kg_m2": [1.0, 1.0, 2.1]}, r"inertia_kg_m2: .* is impossible"),
    ],
)
def test_what_no_body_has_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(cosim.ScenarioError, match=words):
        loaded(**keys)


@pytest.mark.parametrize("tick_s", [4e-3, 2e-3])
def test_a_spring_without_damping_swings_on_at_its_frequency(tick_s: float) -> None:
    circular, mass = 2.0 * np.pi * 5.0, 0.5
    sprung = Joint("slide", (0.0, 0.0, 1.0), stiffness=mass * circular**2)
    item = SceneObject("s", "box", (0.02, 0.02, 0.02), (1.0, 0.5, 1.0), mass_kg=mass, joint=sprung)
    scene = RigidScene(SceneDescription(ARM, objects=(item,), tick_s=tick_s))
    body, drop = scene.body_names.index("s"), 9.81 / circular**2
    height = []
    for _ in range(round(2.0 / tick_s)):
        scene.step()
        height.append(scene.body_poses()[0][body, 2] - 1.0 + drop)  # about where it would rest
    late = np.array(height[len(height) // 2 :])
    assert np.abs(late).max() == pytest.approx(drop, rel=0.02)  # decay below 0.02 per s
    crossings = np.flatnonzero(np.diff(np.sign(height)))
    period = 2.0 * np.diff(crossings).mean() * tick_s
    assert period == pytest.approx(0.2, rel=5e-3)  # (w h)^2 / 12 is 0.13 %, a tick of 20 crossings 0.2 %


def test_a_spring_far_stiffer_than_the_tick_stays_calm() -> None:
    sprung = Joint("slide", (0.0, 0.0, 1.0), stiffness=1e8, damping=1.0)
    item = SceneObject("s", "box", (0.02, 0.02, 0.02), (1.0, 0.5, 1.0), mass_kg=0.1, joint=sprung)
    scene = RigidScene(SceneDescription(ARM, objects=(item,), tick_s=4e-3))
    for _ in range(500):
        scene.step()
    assert abs(scene.body_poses()[0][scene.body_names.index("s"), 2] - 1.0) < 1e-6
