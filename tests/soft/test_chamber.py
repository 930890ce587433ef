"""Chamber meshes against the published examples and against geometry."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh, refine
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import (
    check_mesh,
    dihedral_angle,
    directed_edges,
    interior_hinges,
    triangle_area,
)
from tests.soft.enclosed_volume import enclosed_volume

REFERENCE = Path(__file__).parents[1] / "reference"
ROUNDING_M = 1e-15
"""Positions are products of a few numbers below 1 m."""

HEXAGON_ARM = PolygonalStack(
    sides=6, units=10, corner_radius_m=0.05, taper=0.95, hole_radius_m=0.01, unit_height_m=0.002
)
SQUARE_CORE = PolygonalStack(
    sides=4,
    units=3,
    corner_radius_m=0.03 * np.sqrt(2.0),
    hole_radius_m=0.002 * np.sqrt(2.0),
    mid_ring_fraction=13.0 / 28.0,  # half of the side: 15 mm between the hole's 2 mm and the rim's 30 mm
    unit_height_m=0.002,
    ring_heights=(0.2, 0.5, 0.8),
    first_corner_rad=-0.75 * np.pi,
)


def reference(name: str) -> dict[str, NDArray[Any]]:
    with np.load(REFERENCE / f"{name}.npz") as data:
        return {key: data[key] for key in data.files if data[key].dtype.kind in "fi"}


def oriented(triangles: IntArray) -> set[tuple[int, ...]]:
    """Triangles up to a cyclic shift."""
    first = triangles.argmin(axis=1)
    columns = (first[:, None] + np.arange(3)) % 3
    return {tuple(row) for row in np.take_along_axis(triangles, columns, axis=1).tolist()}


def capped(mesh: NamedMesh) -> IntArray:
    """Triangles of the surface closed by fans over extra centre nodes."""
    fans = [
        np.stack([np.full(len(cap), len(mesh.positions) + c), cap, np.roll(cap, -1)], axis=1)
        for c, cap in enumerate(mesh.caps)
    ]
    return np.concatenate([mesh.triangles, *fans])


def test_hexagon_arm_is_the_mirror_image_of_the_published_one() -> None:
    # The published arm hangs down with corners counted counter-clockwise about +z; ours grows along +z.
    # So z is mirrored with node numbers kept, and a mirror reverses every triangle.
    data, mesh = reference("UR_Pneumatic"), HEXAGON_ARM.mesh()
    drawn = data["X_reference_m"] - (0.3, 0.0, 0.7)
    np.testing.assert_allclose(mesh.positions * (1, 1, -1), drawn, rtol=0, atol=ROUNDING_M)
    assert oriented(mesh.triangles[:, ::-1]) == oriented(data["triangles_pressure_outward"])
    assert mesh.ring("tip").tolist() == data["tip_ring_nodes"][0].tolist()
    assert mesh.ring(mesh.base_ring).tolist() == data["base_ring_nodes"][0].tolist()
    lines = [mesh.line(f"corner_{corner}").tolist() for corner in (0, 1)]
    assert lines == data["cable_routes_nodes_base_to_tip"].tolist()


def test_hanging_down_corners_swap_by_a_proper_rotation() -> None:
    # Turned by pi about x the same arm hangs down; corner k then takes the place of corner 1 - k.
    data, mesh = reference("UR_Pneumatic"), HEXAGON_ARM.mesh()
    place = np.empty(len(mesh.positions), dtype=np.int64)
    for name, ring in mesh.rings.items():
        per_corner = len(ring) // 6
        assert per_corner == (1 if name.endswith(("hole", "tip")) else 2)
        place[ring] = ring[(per_corner - np.arange(len(ring))) % len(ring)]
    turned = mesh.positions * (1, -1, -1) + (0.3, 0.0, 0.7)
    np.testing.assert_allclose(turned, data["X_reference_m"][place], rtol=0, atol=1e-12)
    assert oriented(place[mesh.triangles]) == oriented(data["triangles_pressure_outward"])


def test_square_core_is_the_published_one() -> None:
    data, mesh = reference("Three_Unit_Compare"), SQUARE_CORE.mesh()
    drawn = data["X_reference_m"].copy()
    slip = 8 + 28 * np.arange(3)  # one mid node per unit is drawn at 0.15 of the height, the others at 0.2
    np.testing.assert_allclose(drawn[slip, 2], 0.002 * (np.arange(3) + 0.15), rtol=0, atol=1e-12)
    drawn[slip, 2] = 0.002 * (np.arange(3) + 0.2)
    np.testing.assert_allclose(mesh.positions, drawn, rtol=0, atol=1e-12)
    assert oriented(mesh.triangles) == oriented(data["triangles_pressure_outward"])


@pytest.mark.parametrize("name", ["UR_Pneumatic", "Three_Unit_Compare"])
def test_dihedral_angles_are_the_published_ones(name: str) -> None:
    # Their code takes the arc cosine, good to sqrt(machine epsilon) near pi.
    data = reference(name)
    angle = dihedral_angle(data["X_reference_m"], data["hinge_nodes_ijkl"])
    np.testing.assert_allclose(angle, data["hinge_stressfree_angle_rad"], rtol=0, atol=5e-8)


@pytest.mark.parametrize("name", ["UR_Pneumatic", "Three_Unit_Compare"])
def test_published_hinges_are_among_ours(name: str) -> None:
    data = reference(name)
    ours = interior_hinges(data["triangles_pressure_outward"])
    facing = {frozenset(h[1:3]): frozenset((h[0], h[3])) for h in ours.tolist()}
    for i, j, k, m in data["hinge_nodes_ijkl"].tolist():
        assert facing[frozenset((j, k))] == frozenset((i, m))


def test_counts_of_the_hexagon_arm() -> None:
    mesh = HEXAGON_ARM.mesh()
    hinges = interior_hinges(mesh.triangles, mesh.seam)
    assert (len(mesh.positions), len(mesh.triangles), len(hinges)) == (426, 840, 1134)
    edges = {frozenset(edge) for edge in hinges[:, 1:3].tolist()}
    outer, hole = mesh.ring("unit_2.outer"), mesh.ring("unit_2.hole")
    assert not edges & {frozenset(e) for e in zip(outer, np.roll(outer, -1), strict=True)}
    assert edges >= {frozenset(e) for e in zip(hole, np.roll(hole, -1), strict=True)}


@pytest.mark.parametrize("angle", [0.02, 0.5, np.pi - 1e-9, np.pi, 4.0, 6.27])
def test_dihedral_angle_of_a_folded_pair(angle: float) -> None:
    # Edge along y; one wing along +x, the other turned from it by the angle through +z, seen against +y.
    wing = np.array([np.cos(angle), 0.5, np.sin(angle)])
    positions = np.array([[1.0, 0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], wing])
    hinges = np.array([[0, 1, 2, 3], [3, 2, 1, 0], [3, 1, 2, 0]])
    found = dihedral_angle(positions, hinges)
    np.testing.assert_allclose(found[:2], 2.0 * np.pi - angle, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[2], angle, rtol=0, atol=1e-14)


def test_hinge_angles_open_into_the_gas() -> None:
    # All six faces of a tetrahedron with outward normals meet at acos(1/3), less than pi.
    positions = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    triangles = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    assert enclosed_volume(positions, triangles) == pytest.approx(8.0 / 3.0)
    angle = dihedral_angle(positions, interior_hinges(triangles))
    np.testing.assert_allclose(angle, np.full(6, np.arccos(1.0 / 3.0)), rtol=0, atol=1e-14)


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8])
@pytest.mark.parametrize("levels", [0, 1, 2])
def test_capped_surface_is_closed_and_faces_outward(sides: int, levels: int) -> None:
    stack = PolygonalStack(
        sides=sides, units=2, corner_radius_m=0.05, taper=0.9, hole_radius_m=0.01, unit_height_m=0.004
    )
    mesh = refine(stack.mesh(), levels)
    edges = Counter(map(tuple, directed_edges(capped(mesh)).tolist()))
    assert all(count == 1 and (b, a) in edges for (a, b), count in edges.items())
    assert enclosed_volume(mesh.positions, mesh.triangles, mesh.caps) > 0.0


def test_volume_of_a_unit() -> None:
    # Prismatoid rule on three slabs: cross sections are polygons of area n/2 sin(2 pi/n) r^2, but the
    # odd nodes lie on chords, so each slab between polygons of one shape is an exact frustum.
    n, height, radii = 6, 0.002, np.array([0.01, 0.03, 0.05, 0.03, 0.01])
    stack = PolygonalStack(sides=n, units=1, corner_radius_m=0.05, hole_radius_m=0.01, unit_height_m=height)
    mesh = stack.mesh()
    slab = height / 4
    a, b = radii[:-1], radii[1:]
    exact = 0.5 * n * np.sin(2 * np.pi / n) * np.sum(slab * (a * a + a * b + b * b) / 3)
    assert enclosed_volume(mesh.positions, mesh.triangles, mesh.caps) == pytest.approx(exact, rel=1e-12)
    moved = mesh.positions + np.array((0.4, -0.2, 0.9))  # cancels 1e-4 m^3 terms down to 1e-5
    assert enclosed_volume(moved, mesh.triangles, mesh.caps) == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("stack", [HEXAGON_ARM, SQUARE_CORE])
def test_refinement_keeps_the_drawn_shape(stack: PolygonalStack) -> None:
    coarse = stack.mesh()
    fine = refine(coarse, 2)
    assert len(fine.triangles) == 16 * len(coarse.triangles)
    volume = enclosed_volume(coarse.positions, coarse.triangles, coarse.caps)
    assert enclosed_volume(fine.positions, fine.triangles, fine.caps) == pytest.approx(volume, rel=1e-10)
    area = triangle_area(coarse.positions, coarse.triangles).sum()
    assert triangle_area(fine.positions, fine.triangles).sum() == pytest.approx(area, rel=1e-12)
    assert coarse.rings.keys() == fine.rings.keys()
    for name, ring in coarse.rings.items():
        np.testing.assert_array_equal(fine.positions[fine.ring(name)[::4]], coarse.positions[ring])
    line, drawn = fine.line("corner_2"), coarse.line("corner_2")
    np.testing.assert_array_equal(fine.positions[line], coarse.positions[drawn])


def test_refinement_adds_flat_hinges_and_keeps_the_folds() -> None:
    coarse, fine = HEXAGON_ARM.mesh(), refine(HEXAGON_ARM.mesh(), 1)
    drawn = dihedral_angle(coarse.positions, interior_hinges(coarse.triangles, coarse.seam))
    halved = dihedral_angle(fine.positions, interior_hinges(fine.triangles, fine.seam))
    assert len(halved) == 2 * len(drawn) + 3 * len(coarse.triangles)
    expected = np.sort(np.concatenate([drawn, drawn, np.full(3 * len(coarse.triangles), np.pi)]))
    # Midpoints are rounded: 1e-17 m over a triangle height of 2 mm.
    np.testing.assert_allclose(np.sort(halved), expected, rtol=0, atol=1e-10)


def test_refinement_keeps_the_bandwidth_unit_wise() -> None:
    def bandwidth(mesh: NamedMesh) -> int:
        return int(np.ptp(mesh.triangles, axis=1).max())

    coarse = HEXAGON_ARM.mesh()
    assert bandwidth(refine(coarse, 1)) <= 5 * bandwidth(coarse)


def test_refining_by_zero_levels_is_the_same_mesh() -> None:
    mesh = SQUARE_CORE.mesh()
    assert refine(mesh, 0) is mesh
    with pytest.raises(MeshError, match="levels is -1"):
        refine(mesh, -1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sides": 2}, "sides is 2"),
        ({"units": 0}, "units is 0"),
        ({"hole_radius_m": 0.0}, "hole_radius_m is 0.0"),
        ({"hole_radius_m": 0.05}, "corner_radius_m is 0.05"),
        ({"taper": 0.5}, "9.766e-05 in the smallest unit"),
        ({"taper": -1.0}, "taper is -1.0"),
        ({"unit_height_m": float("nan")}, "unit_height_m is nan"),
        ({"mid_ring_fraction": 1.0}, "mid_ring_fraction is 1.0"),
        ({"ring_heights": (0.5, 0.25, 0.75)}, "ring_heights are"),
    ],
)
def test_impossible_stacks_are_refused(change: dict[str, object], message: str) -> None:
    values = {name: getattr(HEXAGON_ARM, name) for name in HEXAGON_ARM.__dataclass_fields__}
    with pytest.raises(MeshError, match=message):
        PolygonalStack(**(values | change))


SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]], dtype=float)


@pytest.mark.parametrize(
    ("positions", "triangles", "message"),
    [
        (SQUARE[:4], [[0, 1, 2], [0, 1, 3]], r"triangles \[0, 1\] both run along edge \[0, 1\] at \(.*\) mm"),
        (
            SQUARE,
            [[0, 1, 2], [1, 0, 3], [0, 1, 4]],
            r"edge \[0, 1\] at \(.*\) mm belongs to 3 triangles \[0, 1, 2\]",
        ),
        (SQUARE[:3], [[0, 1, 3]], r"triangle 0 uses nodes \[0, 1, 3\]; nodes 0 to 2 exist"),
        (SQUARE[:3], [[0, 1, -1]], "nodes 0 to 2 exist"),
        (SQUARE[:3], [[0, 1, 1]], "one of them twice"),
        (SQUARE[:4], [[0, 1, 2]], "node 3 belongs to no triangle"),
        (SQUARE[:3] * [1, 1e-9, 1], [[0, 1, 2]], "triangle 0 .* degenerate: area 5e-10 m"),
        (SQUARE[:3] * [1, np.nan, 1], [[0, 1, 2]], "node 0 lies at .*nan"),
        (SQUARE[:3, :2], [[0, 1, 2]], r"positions have shape \(3, 2\)"),
        (SQUARE[:3], np.zeros((0, 3), dtype=int), r"triangles have shape \(0, 3\)"),
    ],
)
def test_broken_meshes_are_refused(positions: Array, triangles: object, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        check_mesh(positions, np.array(triangles, dtype=np.int64))


def test_unknown_rings_and_lines_are_named() -> None:
    mesh = SQUARE_CORE.mesh()
    with pytest.raises(MeshError, match=r"no ring 'rim'; there are unit_1\.hole, unit_1\.lower"):
        mesh.ring("rim")
    with pytest.raises(MeshError, match="no line 'corner_4'; there are corner_0, corner_1, "):
        mesh.line("corner_4")


def test_mesh_is_read_only() -> None:
    mesh = SQUARE_CORE.mesh()
    with pytest.raises(ValueError, match="read-only"):
        mesh.positions[0, 0] = 1.0
    with pytest.raises(TypeError):
        mesh.rings["tip"] = mesh.rings["tip"]  # type: ignore[index]
