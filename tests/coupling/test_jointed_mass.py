"""Light bodies on joints between two pads: stable where they give way, thrown out where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.base.state import restore_states, states_of
from cosim.config.schema.objects import WireTable
from cosim.errors import SolverError
from cosim.rigid.build.description import Joint, SceneObject
from tests.coupling.pads import EDGE_M, Grasp

TURNED = SceneObject(
    "cube",
    "box",
    (EDGE_M,) * 3,
    (0.0, 0.0, 1.5),
    mass_kg=5e-3,
    joint=Joint("hinge", (0.0, 1.0, 0.0), (0.0, 0.0, 1.56), damping=1e-5),
)
SHIFTED = replace(TURNED, joint=Joint("slide", (1.0, 0.0, 0.2)))
POST = SceneObject("post", "box", (0.01,) * 3, (0.0, 0.0, 1.62))
WIRE = WireTable(
    "wire", ((0.0, 0.0, 1.58), (0.0, 0.0, 1.37)), 0.5 * EDGE_M, 8e-3, 4, 1e-4, 1e-6, first="post"
)


def travel(tick_s: float, kind: str, light: bool = True) -> Array:
    """Return the path (n, 3) [m] of what is held, from where it was."""
    objects, wires = {"hinge": ((TURNED,), ()), "slide": ((SHIFTED,), ()), "wire": ((POST,), (WIRE,))}[kind]
    grasp = Grasp(1.0, tick_s, light=light, objects=objects, wires=wires)
    begin, path = grasp.cube_position, []
    for _ in range(round(0.2 / tick_s)):
        try:
            report = grasp.tick()
        except SolverError:
            return np.full((1, 3), np.inf)
        path.append(grasp.cube_position - begin)
    assert report.count > 5 or not light
    return np.array(path)


@pytest.mark.parametrize("kind", ["hinge", "slide", "wire"])
@pytest.mark.parametrize("tick_s", [1e-3, 2e-3, 5e-3])
def test_light_bodies_on_joints_are_stable(kind: str, tick_s: float) -> None:
    path = travel(tick_s, kind)
    assert np.abs(path).max() < 2e-3
    assert np.ptp(path[-len(path) // 5 :], axis=0).max() < 1e-4


@pytest.mark.parametrize("kind", ["hinge", "slide", "wire"])
def test_a_tick_late_they_are_thrown_about(kind: str) -> None:
    assert np.abs(travel(5e-3, kind, light=False)).max() > 5e-3


def test_a_wire_between_pads_repeats_from_a_saved_state() -> None:
    grasp = Grasp(1.0, 2e-3, objects=(POST,), wires=(WIRE,))
    for _ in range(25):
        grasp.tick()
    assert grasp.coupling is not None
    assert grasp.ratio > 1.0
    parts = {"scene": grasp.scene, **grasp.coupling.parts()}
    soft, saved = grasp.soft.full_state, states_of(parts)
    ends = []
    for _ in range(2):
        grasp.soft.full_state = soft
        restore_states(parts, saved)
        for _ in range(15):
            grasp.tick()
        ends.append(np.concatenate([grasp.scene.body_poses()[0].ravel(), grasp.soft.state.positions.ravel()]))
    np.testing.assert_array_equal(*ends)
