"""Meshes refined at the holes of a stack, with films fused there: the drawn shape and its names stay."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh, refine
from cosim.soft.geometry.polygonal_stack import FUSED, PolygonalStack, with_finer_holes
from cosim.soft.geometry.surface import dihedral_angle, interior_hinges, triangle_area
from tests.soft.enclosed_volume import enclosed_volume

SQUARES = PolygonalStack(4, 2, 0.0424, 0.0028, 0.002, ring_heights=(0.2, 0.5, 0.8))
HEXAGONS = PolygonalStack(6, 2, 0.05, 0.01, 0.002, taper=0.95)
TRIANGLES = PolygonalStack(3, 1, 0.05, 0.004, 0.002)
CASES = [
    (stack, levels, fused)
    for (stack, radius), levels in product(((SQUARES, 0.008), (HEXAGONS, 0.014), (TRIANGLES, 0.007)), (1, 2))
    for fused in (None, radius)
]


def holes_of(mesh: NamedMesh) -> Sequence[str]:
    return [name for name in mesh.rings if name.endswith(".hole") or name == "tip"]


def finer(stack: PolygonalStack, levels: int, fused: float | None = None) -> NamedMesh:
    mesh = stack.mesh()
    return with_finer_holes(mesh, holes_of(mesh), levels, fused)


def shapes_of(mesh: NamedMesh, map_: Array) -> set[Any]:
    """Return the triangles as sets of corners, mapped; nm tell nodes apart and rounding not."""
    corners = np.rint((mesh.positions @ map_.T)[mesh.triangles] / 1e-9).astype(int)
    return {frozenset(map(tuple, triangle)) for triangle in corners.tolist()}


@pytest.mark.parametrize(("stack", "levels", "fused"), CASES)
def test_the_drawn_shape_stays(stack: PolygonalStack, levels: int, fused: float | None) -> None:
    drawn, mesh = stack.mesh(), finer(stack, levels, fused)
    area = triangle_area(drawn.positions, drawn.triangles).sum()
    assert triangle_area(mesh.positions, mesh.triangles).sum() == pytest.approx(area, rel=1e-12)
    volume = enclosed_volume(drawn.positions, drawn.triangles, drawn.caps)
    assert enclosed_volume(mesh.positions, mesh.triangles, mesh.caps) == pytest.approx(volume, rel=1e-10)
    # folds keep their angles, the new hinges beside them are flat
    folds, angles = (
        dihedral_angle(own.positions, interior_hinges(own.triangles, own.seam)) for own in (drawn, mesh)
    )
    bent = angles[np.abs(angles - np.pi) > 1e-6]
    assert np.abs(bent[:, None] - folds).min(axis=1).max() < 1e-8
    sharp = folds[np.abs(folds - np.pi) > 1e-6]
    assert np.abs(sharp[:, None] - angles).min(axis=1).max() < 1e-8


@pytest.mark.parametrize(("stack", "levels", "fused"), CASES)
def test_rings_and_lines_keep_their_names_and_order(
    stack: PolygonalStack, levels: int, fused: float | None
) -> None:
    drawn, mesh = stack.mesh(), finer(stack, levels, fused)
    for name, ring in drawn.rings.items():
        cuts = 2**levels if name in holes_of(drawn) else 1
        np.testing.assert_array_equal(mesh.positions[mesh.ring(name)[::cuts]], drawn.positions[ring])
        if cuts == 1 and (fused is None or levels == 1):
            assert len(mesh.ring(name)) == len(ring)
        x, y, _ = mesh.positions[mesh.ring(name)].T
        turns = np.diff(np.unwrap(np.arctan2(y, x)))
        assert (turns > 0.0).all(), name
    for cap, ring in zip(mesh.caps, ("unit_1.hole", "tip"), strict=True):
        assert set(cap.tolist()) == set(mesh.ring(ring).tolist())
    np.testing.assert_array_equal(mesh.positions[mesh.seam], drawn.positions[drawn.seam])
    line = mesh.positions[mesh.line("corner_1")]
    np.testing.assert_array_equal(line, drawn.positions[drawn.line("corner_1")])


@pytest.mark.parametrize(("stack", "levels", "fused"), CASES)
def test_mirrors_and_turns_that_keep_the_drawn_mesh_keep_this_one(
    stack: PolygonalStack, levels: int, fused: float | None
) -> None:
    mesh = finer(stack, levels, fused)
    angle = 2.0 * np.pi / stack.sides
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0, 0, 1.0]])
    for symmetry in (np.diag([1.0, -1.0, 1.0]), turn):
        assert shapes_of(mesh, symmetry) == shapes_of(mesh, np.eye(3))


@pytest.mark.parametrize(
    ("levels", "fused", "triangles"),
    [(0, None, 14), (1, None, 28), (2, None, 56), (1, 0.008, 28), (2, 0.008, 84)],
)
def test_only_what_is_at_the_holes_is_cut(levels: int, fused: float | None, triangles: int) -> None:
    mesh = finer(SQUARES, levels, fused)
    assert len(mesh.triangles) == triangles * SQUARES.sides * SQUARES.units
    assert len(refine(mesh, 1).triangles) == 4 * len(mesh.triangles)


def test_nodes_lie_at_a_third_of_the_logarithmic_way_outwards() -> None:
    mesh = finer(SQUARES, 1)
    distance = np.hypot(*mesh.positions[:, :2].T)
    middle = SQUARES.hole_radius_m + 0.5 * (SQUARES.corner_radius_m - SQUARES.hole_radius_m)
    for far in (middle, middle / np.sqrt(2.0)):
        at = SQUARES.hole_radius_m ** (2.0 / 3.0) * far ** (1.0 / 3.0)
        assert np.abs(distance - at).min() < 1e-12


@pytest.mark.parametrize("levels", [1, 2])
def test_fused_triangles_fill_the_disc(levels: int) -> None:
    mesh = refine(finer(SQUARES, levels, 0.008), 1)
    fused, distance = mesh.face_groups[FUSED], np.hypot(*mesh.positions[:, :2].T)[mesh.triangles]
    assert distance[fused].max() == pytest.approx(0.008, rel=1e-9)
    # chords between 12 nodes on the circle; the film climbs by 0.4 mm over 13 mm
    inner = 2.0 * SQUARES.hole_radius_m**2
    area = triangle_area(mesh.positions, mesh.triangles)[fused].sum() / 4.0
    assert area == pytest.approx(np.pi * 0.008**2 - inner, rel=0.07)


@pytest.mark.parametrize(
    ("levels", "fused", "message"),
    [
        (1, 0.0028, r"fused_radius_m is 0\.0028; it must lie between 0\.0028"),
        (1, 0.016, r"fused_radius_m is 0\.016; it must lie between 0\.0028, .* and 0\.01598"),
        (0, 0.008, "holes are refined 0 times; fused films need 1 or more"),
    ],
)
def test_discs_without_room_are_refused(levels: int, fused: float, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        finer(SQUARES, levels, fused)


GRADED = [(stack, fused) for stack, levels, fused in CASES if levels == 1]


@pytest.mark.parametrize(("stack", "fused"), GRADED)
def test_a_graded_mesh_is_of_the_same_shape_and_names(stack: PolygonalStack, fused: float | None) -> None:
    drawn, mesh = stack.mesh(), stack.graded_mesh(fused)
    area = triangle_area(drawn.positions, drawn.triangles).sum()
    # a film of squares is kinked where the mid ring of the drawn mesh is, by 0.2 mm
    assert triangle_area(mesh.positions, mesh.triangles).sum() == pytest.approx(area, rel=1e-4)
    assert enclosed_volume(mesh.positions, mesh.triangles, mesh.caps) > 0.0
    assert mesh.rings.keys() == drawn.rings.keys()
    for name in (*holes_of(drawn), *drawn.seam_rings):
        cuts = len(mesh.ring(name)) // len(drawn.ring(name))
        np.testing.assert_allclose(
            mesh.positions[mesh.ring(name)[::cuts]], drawn.positions[drawn.ring(name)], atol=1e-15
        )
    for name, line in drawn.lines.items():
        np.testing.assert_allclose(mesh.positions[mesh.line(name)], drawn.positions[line], atol=1e-15)
    angle = 2.0 * np.pi / stack.sides
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0, 0, 1.0]])
    for symmetry in (np.diag([1.0, -1.0, 1.0]), turn):
        assert shapes_of(mesh, symmetry) == shapes_of(mesh, np.eye(3))


def test_fused_triangles_of_a_graded_mesh_are_those_within_the_radius() -> None:
    mesh = SQUARES.graded_mesh(0.008)
    distance = np.hypot(*mesh.positions[:, :2].T)[mesh.triangles]
    within = np.flatnonzero((distance < 0.008 * (1.0 + 1e-9)).all(axis=1))
    np.testing.assert_array_equal(mesh.face_groups[FUSED], within)
    assert np.isclose(distance[within], 0.008).any(axis=1).all()
