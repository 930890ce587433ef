"""Colours, creases, normals and cameras of a recording."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.recording.eyes import close_eye, scene_eye, soft_size
from cosim.recording.film_colours import stress_scale
from cosim.recording.lines import crease_lines
from cosim.recording.rigid_meshes import corner_normals
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

MakeStage = Callable[..., RunInfo]
MakeSnapshot = Callable[..., Snapshot]

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def lightness(rgba: Array) -> Array:
    """CIE lightness of sRGB colours (n, 4): another measure than the one the scale is built on."""
    share = rgba[:, :3] / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    return np.asarray(116.0 * np.cbrt(np.maximum(luminance, 0.009)) - 16.0)


def test_stress_scale_rises_evenly_in_lightness() -> None:
    steps = np.diff(lightness(stress_scale(33).astype(float)))
    assert steps.min() > 0.0
    # The two measures of lightness differ by some ten per cent along the scale, and so does the slope.
    assert steps.max() < 2.0 * steps.min()
    assert lightness(stress_scale(2).astype(float))[0] > 20.0  # not lost on the dark ground


def test_creases_are_the_welds() -> None:
    stack = PolygonalStack(sides=6, units=3, corner_radius_m=0.05, hole_radius_m=0.01, unit_height_m=0.002)
    mesh = stack.mesh()
    lines = crease_lines(mesh.positions, mesh.triangles)
    found = {frozenset(line.tolist()) for line in lines}
    assert found == {frozenset(mesh.ring(f"unit_{k}.outer").tolist()) for k in (1, 2, 3)}
    assert all(line[0] == line[-1] and len(line) == 13 for line in lines)


def test_open_crease_is_one_line() -> None:
    # A ridge over three edges, folded to 60 degrees, with flat wings.
    along = np.arange(4.0)
    ridge = np.stack([along, 0 * along, 0 * along], axis=1)
    wings = [ridge + np.array([0.0, side * 0.5, -np.sqrt(0.75)]) for side in (-1.0, 1.0)]
    positions = np.concatenate([ridge, *wings])
    k = np.arange(3)
    right, left = 4 + k, 8 + k
    triangles = np.concatenate(
        [np.stack(rows, axis=1) for rows in (
            (k, right, right + 1), (k, right + 1, k + 1), (k, left + 1, left), (k, k + 1, left + 1)
        )]
    )  # fmt: skip
    (line,) = crease_lines(positions, triangles)
    assert line.tolist() in ([0, 1, 2, 3], [3, 2, 1, 0])


def test_normals_are_sharp_on_a_cube() -> None:
    normals = corner_normals(CUBE, CUBE_FACES)
    a, b, c = (CUBE[CUBE_FACES[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a) / 4.0
    np.testing.assert_allclose(normals, np.repeat(faces, 3, axis=0), atol=1e-12)
    assert (np.einsum("ca,ca->c", normals, CUBE[CUBE_FACES.ravel()]) > 0.9).all()


def test_normals_are_smooth_on_a_round_prism() -> None:
    # 24 sides turn by 15 degrees each, less than the bound of 35: radial normals.
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    low = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([low, low + np.array([0.0, 0.0, 1.0])])
    i, j = np.arange(24), np.roll(np.arange(24), -1)
    triangles = np.concatenate([np.stack([i, j, 24 + j], axis=1), np.stack([i, 24 + j, 24 + i], axis=1)])
    normals = corner_normals(vertices, triangles)
    radial = vertices[triangles.ravel()] * (1.0, 1.0, 0.0)
    # Two triangles of one side and one of the other meet at a vertex: the mean is 2.5 degrees off.
    assert np.einsum("ca,ca->c", normals, radial).min() > np.cos(np.radians(2.6))


def test_soft_robot_is_as_large_as_its_film() -> None:
    # Independent of how it is folded: a square of side 2 in two triangles.
    positions = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], dtype=float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    assert soft_size_of(positions, triangles) == pytest.approx(2.0)


def soft_size_of(positions: Array, triangles: Array) -> float:
    class Parts:
        soft_triangles = triangles
        node_position = positions

    return soft_size(Parts, Parts)  # type: ignore[arg-type]


def test_cameras_see_everything(make_stage: MakeStage, make_snapshot: MakeSnapshot) -> None:
    stage = make_stage()
    first = make_snapshot(stage, 0)
    eye = scene_eye(stage, first)
    for point in (*first.node_position, *(stage.shapes[0].vertices + first.body_position[1])):
        ray = point - eye.position
        angle = np.arccos(-ray @ eye.direction / np.linalg.norm(ray))
        assert angle < np.radians(36.0)  # corner of a square picture 55 degrees high
    assert eye.direction[1] < -0.5  # to the right of the way from base to flange, which is +x
    close = close_eye(stage, first)
    assert np.linalg.norm(close.position) < np.linalg.norm(eye.position - eye.target)
    assert close.left @ close.direction == pytest.approx(0.0, abs=1e-15)
    assert np.cross(-close.direction, close.left)[2] > 0.0  # ahead, left and up are right-handed


def test_floor_does_not_push_the_camera_away(make_stage: MakeStage, make_snapshot: MakeSnapshot) -> None:
    stage = make_stage()
    shape = stage.shapes[0]
    floor = type(shape)(0, shape.vertices * 50.0, shape.triangles, shape.rgba)
    with_floor = make_stage(shapes=(shape, floor))
    first = make_snapshot(stage, 0)
    np.testing.assert_array_equal(scene_eye(stage, first).position, scene_eye(with_floor, first).position)
