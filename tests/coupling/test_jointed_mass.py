"""Light bodies on joints between two pads: stable with the film's algorithmic mass, thrown out without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.config.schema.objects import WireTable
from cosim.coupling.contact.added_mass import bounding_blocks
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


def travel(tick_s: float, kind: str, carried: bool = True) -> Array:
    """Return the path (n, 3) [m] of what is held, from where it was."""
    objects, wires = {
        "hinge": ((TURNED,), ()),
        "slide": ((SHIFTED,), ()),
        "wire": ((POST,), (WIRE,)),
    }[kind]
    grasp = Grasp(1.0, tick_s, carried=carried, objects=objects, wires=wires)
    begin, path = grasp.cube_position, []
    for _ in range(round(0.2 / tick_s)):
        try:
            report = grasp.tick()
        except SolverError:
            return np.full((1, 3), np.inf)
        path.append(grasp.cube_position - begin)
    assert report.count > 5 or not carried
    return np.array(path)


@pytest.mark.parametrize("kind", ["hinge", "slide", "wire"])
@pytest.mark.parametrize("tick_s", [1e-3, 2e-3, 5e-3])
def test_light_bodies_on_joints_are_stable(kind: str, tick_s: float) -> None:
    path = travel(tick_s, kind)
    assert np.abs(path).max() < 2e-3
    assert np.ptp(path[-len(path) // 5 :], axis=0).max() < 1e-4


@pytest.mark.parametrize("kind", ["hinge", "slide", "wire"])
def test_without_the_carried_mass_they_are_thrown_about(kind: str) -> None:
    assert np.abs(travel(5e-3, kind, carried=False)).max() > 5e-3


def test_the_body_s_own_axes_do_not_matter() -> None:
    # a third of a turn about its diagonal leaves a cube as it is, but not the axes of what it carries
    ends = []
    for quaternion in ((1.0, 0.0, 0.0, 0.0), (0.5, 0.5, 0.5, 0.5)):
        grasp = Grasp(1.0, 2e-3, objects=(replace(TURNED, quaternion=quaternion),))
        for _ in range(25):
            grasp.tick()
        assert grasp.mass is not None
        assert grasp.mass.ratio > 1.0
        ends.append(np.array([*grasp.cube_position, 1e-3 * grasp.mass.ratio]))
    assert ends[0] == pytest.approx(ends[1], abs=1e-8)


def test_the_bounding_blocks_bound() -> None:
    root = np.random.default_rng(0).normal(size=(12, 9))
    whole = root @ root.T
    blocks = bounding_blocks(whole)
    bound = np.zeros((12, 12))
    bound[:6, :6], bound[6:, 6:] = blocks
    assert np.linalg.eigvalsh(bound - whole).min() > -1e-9
    assert np.linalg.eigvalsh(0.999 * bound - whole).min() < 0.0
    np.testing.assert_allclose(bounding_blocks(whole[:6, :6])[0], whole[:6, :6], atol=1e-9)


def test_a_wire_between_pads_repeats_from_a_saved_state() -> None:
    grasp = Grasp(1.0, 2e-3, objects=(POST,), wires=(WIRE,))
    for _ in range(25):
        grasp.tick()
    assert grasp.mass is not None
    assert grasp.mass.ratio > 1.0
    parts = (grasp.scene, grasp.soft, grasp.exchange, grasp.mass)
    saved = [part.save_state() for part in parts]
    ends = []
    for _ in range(2):
        for part, state in zip(parts, saved, strict=True):
            part.restore_state(state)
        for _ in range(15):
            grasp.tick()
        ends.append(np.concatenate([grasp.scene.body_poses()[0].ravel(), grasp.soft.state.positions.ravel()]))
    np.testing.assert_array_equal(*ends)
