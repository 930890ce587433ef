"""Links of an arm that stand in objects or in one another."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene

ARM = find_arm("ur5e")


@pytest.mark.parametrize("name", list_arms())
def test_at_home_nothing_touches(name: str) -> None:
    arm = find_arm(name)
    assert RigidScene(SceneDescription(arm)).links.at(arm.home) == ()


def test_a_link_in_an_object_is_named_with_its_depth() -> None:
    """The forearm, a cylinder of 49 mm radius about its axis, in a plate whose face cuts that axis."""
    scene = RigidScene(SceneDescription(ARM))
    names, places = scene.body_names, scene.body_poses()[0]
    elbow, wrist = places[names.index("forearm_link")], places[names.index("wrist_1_link")]
    top = float(min(elbow[2], wrist[2])) - 0.02
    plate = SceneObject("plate", "box", (0.1, 1.0, 0.1), (0.5 * (elbow[0] + wrist[0]), 0.0, top - 0.05))
    found = RigidScene(SceneDescription(ARM, objects=(plate,))).links.at(ARM.home)
    assert [(contact.link, contact.other) for contact in found] == [("forearm_link", "plate")]
    assert 0.01 < found[0].depth_m < 0.06
    assert not found[0].movable


def test_free_objects_are_where_they_are_said_to_be() -> None:
    ball = SceneObject("ball", "sphere", (0.05,), (1.5, 1.5, 1.0), mass_kg=0.1)
    scene = RigidScene(SceneDescription(ARM, objects=(ball,)))
    places, quaternions = scene.body_poses()
    names = scene.body_names
    assert scene.links.at(ARM.home, places, quaternions) == ()
    places[names.index("ball")] = places[names.index("wrist_2_link")]
    found = {contact.other: contact for contact in scene.links.at(ARM.home, places, quaternions)}
    assert found["ball"].movable
    assert scene.links.at(ARM.home) == ()  # nothing has changed


def test_a_forearm_folded_onto_the_upper_arm_touches_it_with_its_wrist() -> None:
    scene = RigidScene(SceneDescription(ARM))
    folded = np.array([0.0, -0.5 * np.pi, 3.1, 0.0, 0.0, 0.0])
    pairs = {(contact.link, contact.other) for contact in scene.links.at(folded)}
    assert any(first == "upper_arm_link" and other.startswith("wrist") for first, other in pairs), pairs


def test_objects_on_the_floor_are_no_business_of_the_arm() -> None:
    cube = SceneObject("cube", "box", (0.1, 0.1, 0.1), (1.0, 0.0, 0.0499), mass_kg=0.1)
    scene = RigidScene(SceneDescription(ARM, objects=(cube,)))
    scene.begin_step()
    assert scene.links.with_objects() == scene.links.at(ARM.home) == ()


def test_contacts_of_the_scene_itself_are_read() -> None:
    ball = SceneObject("ball", "sphere", (0.05,), mass_kg=0.1)
    places = RigidScene(SceneDescription(ARM)).body_poses()[0]
    names = RigidScene(SceneDescription(ARM)).body_names
    wrist = places[names.index("wrist_2_link")]
    moved = SceneObject("ball", "sphere", (0.05,), tuple(wrist.tolist()), mass_kg=ball.mass_kg)
    scene = RigidScene(SceneDescription(ARM, objects=(moved,)))
    live, searched = scene.links.with_objects(), scene.links.at(ARM.home)
    assert live
    assert {(c.link, c.other) for c in live} == {(c.link, c.other) for c in searched}


def test_an_arm_that_is_far_from_everything_is_not_looked_at_again_and_nothing_is_missed() -> None:
    """Slowly into the floor and back: every look agrees with that of a scene that has looked elsewhere."""
    scene, fresh = RigidScene(SceneDescription(ARM)), RigidScene(SceneDescription(ARM))
    share = np.concatenate([np.linspace(0.0, 1.0, 400), np.linspace(1.0, 0.0, 400)])
    way = ARM.home + share[:, None] * np.array([0.0, 1.0, 0.3, 0.0, 0.4, 0.0])
    touched = 0
    for q in way:
        found = {(contact.link, contact.other) for contact in scene.links.at(q)}
        fresh.links.at(ARM.home + 1.0)  # far away: what follows is computed
        assert found == {(contact.link, contact.other) for contact in fresh.links.at(q)}
        touched += bool(found)
    assert 0 < touched < 800


def test_a_film_in_the_forearm_of_the_arm_that_carries_it_is_named() -> None:
    scene = RigidScene(SceneDescription(ARM))
    scene.set_joint_state(ARM.home)
    names, places = scene.body_names, scene.body_poses()[0]
    elbow, wrist = places[names.index("forearm_link")], places[names.index("wrist_1_link")]
    axis = (wrist - elbow) * (1.0, 0.0, 1.0)  # the wrist stands beside it
    inside = elbow + np.array([[0.5], [0.6]]) * axis
    away = inside + np.array([0.0, 0.0, 1.0])
    (found,) = scene.links.with_film(np.concatenate([away, inside]), ARM.home)
    assert found.link == "forearm_link"
    assert found.node in (2, 3)
    assert 0.01 < found.depth_m < 0.06  # a cylinder of 49 mm radius
    assert scene.links.with_film(away, ARM.home) == ()
    # it begins at the flange, in what carries that
    assert scene.links.with_film(scene.flange_pose.translation[None], ARM.home) == ()
