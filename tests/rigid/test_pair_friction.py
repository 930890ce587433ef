"""Friction of pairs: the rule, named pairs, and that it holds up to its limit and no further."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.base.kept_parts import KeptParts
from cosim.build.arm_parts import ArmParts
from cosim.build.arms import find_arm
from cosim.config.loading import load_scenario
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.build.pair_friction import PairFriction
from cosim.rigid.scene.scene import RigidScene

ARM = find_arm("ur5e")
OF_CUBE, OF_TABLE = 0.32, 0.5
RULES = {"largest": 0.5, "smallest": 0.32, "mean": 0.41, "root": 0.4}
CASES = [("largest", k) for k in range(8)] + [
    (rule, k) for rule in ("smallest", "mean", "root") for k in (1, 6)
]
NAMED = PairFriction("smallest", pairs=(("table", "cube", 0.2),))


def scene_on_slope(friction: PairFriction, slope: float, direction: float, *, palm: bool) -> RigidScene:
    """Return a cube on a table, under weight along it by a share of that on it."""
    along = slope * 9.81 * np.array([np.cos(direction), np.sin(direction)])
    cube = SceneObject("cube", "box", (0.02, 0.02, 0.02), (1.0, 0.0, 0.02), mass_kg=0.2, friction=OF_CUBE)
    carried = (SceneObject("palm", "box", (0.02, 0.02, 0.02), (0.0, 0.0, 0.1)),) if palm else ()
    table = SceneObject("table", "box", (2.0, 2.0, 0.1), (1.0, 0.0, -0.1), friction=OF_TABLE)
    made = SceneDescription(
        ARM, objects=(table, cube), mounted=carried, floor_height_m=None, tick_s=4e-3, friction=friction
    )
    return RigidScene(replace(made, gravity=(*along.tolist(), -9.81)))


def slid(scene: RigidScene, after: int, ticks: int) -> float:
    """Return the distance [m] by which the cube goes in some ticks of 4 ms after some others."""

    def place(count: int) -> Array:
        for _ in range(count):
            scene.step()
        return scene.body_poses()[0][scene.body_names.index("cube"), :2]

    return float(np.linalg.norm(-place(after) + place(ticks)))


@pytest.mark.parametrize("palm", [False, True])
@pytest.mark.parametrize(("rule", "eighth"), CASES)
def test_friction_holds_up_to_its_limit_in_any_direction_with_or_without_a_palm(
    rule: str, eighth: int, palm: bool
) -> None:
    check_limit(PairFriction(rule), RULES[rule], 0.25 * np.pi * eighth, palm=palm)


def test_a_named_pair_has_its_own_friction() -> None:
    check_limit(NAMED, 0.2, 0.0, palm=False)


def check_limit(friction: PairFriction, mu: float, direction: float, *, palm: bool) -> None:
    assert slid(scene_on_slope(friction, 0.9 * mu, direction, palm=palm), 375, 125) < 0.5 * 1e-6  # 1e-3 mm/s
    # beyond the limit it slides: x = (slope - mu) g t^2 / 2 from t1 to t2
    gone = slid(scene_on_slope(friction, 1.5 * mu, direction, palm=palm), 125, 50)
    first, last = 0.5, 0.7
    realised = 1.5 * mu - 2.0 * gone / (9.81 * (last**2 - first**2))
    assert realised == pytest.approx(mu, rel=0.02)


def loaded(**contact: Any) -> RigidScene:
    """Return the scene of a scenario with a block, a bar and a palm."""
    solid = {"shape": "box", "size_m": [0.04, 0.04, 0.04]}
    scenario = load_scenario(
        "ur5e_hexagon_arm",
        {
            "object": [
                {"name": "block", "position_m": [0.6, 0.3, 0.1], "mass_kg": 0.1, "friction": 0.4} | solid,
                {"name": "bar", "position_m": [0.6, -0.3, 0.1], "friction": 0.9} | solid,
            ],
            "soft_robot.palm": {"radius_m": 0.05, "thickness_m": 0.01, "mass_kg": 0.1, "friction": 0.2},
            "contact": contact,
        },
    )
    return ArmParts(scenario, KeptParts()).scene


def film_on(scene: RigidScene) -> dict[str, float]:
    """Return the coefficient of the film on each body."""
    query = scene.contact_query()
    return {scene.body_names[b]: float(mu) for b, mu in zip(query.body, query.friction, strict=True)}


def test_film_and_objects_follow_the_same_rule() -> None:
    theirs = {"floor": 0.8, "block": 0.4, "bar": 0.9}
    for rule in RULES:
        assert film_on(loaded(pair_friction=rule)) == pytest.approx(theirs)  # film has none of its own
    assert film_on(loaded(film_friction=0.5)) == pytest.approx({"floor": 0.8, "block": 0.5, "bar": 0.9})
    smallest = loaded(film_friction=0.5, pair_friction="smallest")
    assert film_on(smallest) == pytest.approx({"floor": 0.5, "block": 0.4, "bar": 0.5})
    pair = [{"between": ["film", "block"], "friction": 0.1}]
    assert film_on(loaded(pair=pair)) == pytest.approx(theirs | {"block": 0.1})


def test_of_a_pair_but_the_friction_all_stays_as_mujoco_has_it() -> None:
    largest, named = (scene_on_slope(f, 0.0, 0.0, palm=False) for f in (PairFriction(), NAMED))
    assert slid(largest, 1, 100) == slid(named, 1, 100) == pytest.approx(0.0, abs=1e-9)
    depth = [scene.body_poses()[0][scene.body_names.index("cube"), 2] for scene in (largest, named)]
    assert depth[0] == pytest.approx(depth[1], abs=1e-12)


@pytest.mark.parametrize(("friction", "mu"), [(PairFriction(), 0.8), (NAMED, OF_CUBE)])
def test_every_corner_of_an_object_may_touch_the_palm(friction: PairFriction, mu: float) -> None:
    model = CompiledScene(scene_on_slope(friction, 0.0, 0.0, palm=True).description).model()
    names = [model.geom(k).name for k in range(model.ngeom)]
    corners = [k for k, name in enumerate(names) if name.startswith("cube") and "corner" in name]
    places = sorted(tuple(np.round(model.geom_pos[k], 12)) for k in corners)
    assert places == sorted(itertools.product((-0.01, 0.01), repeat=3))
    palm = [k for k in range(model.ngeom) if model.body(model.geom_bodyid[k]).name == "palm"]
    met = {frozenset(map(int, pair)): k for k, pair in enumerate(np.c_[model.pair_geom1, model.pair_geom2])}
    for pair in itertools.product(corners, palm):
        assert model.pair_friction[met[frozenset(pair)], :2] == pytest.approx([mu, mu])


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        ({"between": ["film", "blok"], "friction": 0.1}, r"contact\.pair.*between.*blok.*block"),
        ({"between": ["film", "film"], "friction": 0.1}, r"set contact\.self_friction"),
    ],
)
def test_pairs_name_what_is_there(pair: dict[str, Any], words: str) -> None:
    with pytest.raises(cosim.ScenarioError, match=words):
        loaded(pair=[pair])
