"""Drawn meshes: closed, outward, and as large as the shapes they stand for."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cosim.base.frames import Pose
from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.rigid.build import drawn_shapes
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.scene.scene import RigidScene


def volume(mesh: drawn_shapes.Mesh) -> float:
    vertices, triangles = mesh
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


# A 32-gon has 0.994 of its circle's area; the chamfer takes at most another half percent.
@pytest.mark.parametrize(
    ("mesh", "exact"),
    [
        (drawn_shapes.box(np.array([0.1, 0.2, 0.3])), 8 * 0.1 * 0.2 * 0.3),
        (drawn_shapes.sphere(0.2), 4 / 3 * np.pi * 0.2**3),
        (drawn_shapes.ellipsoid(np.array([0.1, 0.2, 0.3])), 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
        (drawn_shapes.cylinder(0.1, 0.3), np.pi * 0.1**2 * 0.6),
        (drawn_shapes.capsule(0.1, 0.3), np.pi * 0.1**2 * 0.6 + 4 / 3 * np.pi * 0.1**3),
    ],
    ids=["box", "sphere", "ellipsoid", "cylinder", "capsule"],
)
def test_volume_is_positive_and_right(mesh: drawn_shapes.Mesh, exact: float) -> None:
    assert 0.97 * exact < volume(mesh) <= exact * (1 + 1e-12)
    # The divergence theorem holds about any origin only for a closed surface.
    moved = (mesh[0] + np.array([3.0, -2.0, 5.0]), mesh[1])
    np.testing.assert_allclose(volume(moved), volume(mesh), rtol=1e-9)


def test_no_triangle_is_degenerate() -> None:
    for vertices, triangles in (
        drawn_shapes.sphere(0.2),
        drawn_shapes.capsule(0.1, 0.3),
        drawn_shapes.box(np.ones(3)),
    ):
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        assert np.min(np.linalg.norm(np.cross(b - a, c - a), axis=1)) > 1e-8


def test_checkerboard_covers_the_plane_facing_up() -> None:
    areas = []
    for vertices, triangles in drawn_shapes.checkerboard(np.array([1.0, 0.5]), 0.25):
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        assert np.all(normal[:, 2] > 0.0)
        areas.append(0.5 * np.sum(normal[:, 2]))
    np.testing.assert_allclose(areas, [1.0, 1.0], rtol=1e-12)


@pytest.mark.parametrize("name", list_arms())
def test_every_arm_is_drawn_link_by_link(name: str) -> None:
    scene = RigidScene(SceneDescription(find_arm(name)))
    drawn = {scene.body_names[shape.body] for shape in scene.shapes}
    assert len(drawn) >= len(scene.joint_names) + 1
    for shape in scene.shapes:
        assert shape.triangles.max() < len(shape.vertices)
        assert np.all(np.isfinite(shape.vertices))
        assert all(0.0 <= c <= 1.0 for c in shape.rgba)


def test_object_is_drawn_in_its_size_and_colour() -> None:
    box = SceneObject("box", "box", (0.2, 0.4, 0.6), (1.0, 0.0, 0.3), rgba=(1.0, 0.0, 0.5, 1.0))
    scene = RigidScene(SceneDescription(find_arm("ur5e"), objects=(box,)))
    shape = next(s for s in scene.shapes if scene.body_names[s.body] == "box")
    np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), box.size_m)
    np.testing.assert_allclose(shape.rgba, box.rgba, atol=1e-6)


def test_ur5e_reaches_from_base_to_flange_without_gaps() -> None:
    """Every link's drawing must come within 5 mm of the next one's, in the world at home."""
    scene = RigidScene(SceneDescription(find_arm("ur5e"), floor_height_m=None))
    positions, quaternions = scene.body_poses()
    clouds: dict[int, list[np.ndarray]] = {}
    for shape in scene.shapes:
        world_from_body = Pose.from_quaternion(quaternions[shape.body], positions[shape.body])
        clouds.setdefault(shape.body, []).append(world_from_body.apply(shape.vertices))
    bodies = sorted(clouds)
    for near, far in pairwise(bodies):
        gap = float(np.min(cdist(np.concatenate(clouds[near]), np.concatenate(clouds[far]))))
        assert gap < 0.005, (scene.body_names[near], scene.body_names[far], gap)
    tip = np.concatenate(clouds[bodies[-1]])
    flange = scene.flange_pose
    heights = (tip - flange.translation) @ flange.rotation[:, 2]
    np.testing.assert_allclose(heights.max(), 0.0, atol=1e-9)  # the drawn face is the mounting face
