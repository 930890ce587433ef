"""Hinges by the shell rule: a sheet bent to a cylinder stores D kappa^2 A / 2."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.elements.element import Remembered
from cosim.soft.elements.hinge import (
    HingeRows,
    add_hinges,
    bending_measure,
    hinge_areas,
    mean_square_angle,
    shell_stiffness,
)
from cosim.soft.geometry.named_mesh import NamedMesh, refine
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import interior_hinges, triangle_area
from tests.soft.bodies import FILM

RIGIDITY_Nm = FILM.flexural_rigidity_Nm
SIDE_M = 0.02


def equilateral_sheet(count: int) -> tuple[Array, IntArray]:
    """Return a rhombus of equilateral triangles, `count` along each side of SIDE_M."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij"))
    step = SIDE_M / count
    positions = step * np.stack([i + 0.5 * j, 0.5 * np.sqrt(3.0) * j, 0.0 * i], axis=1)
    return positions, _two_per_cell(count, lambda a, b: np.ones_like(a, dtype=bool))


def square_sheet(count: int, alternating: bool) -> tuple[Array, IntArray]:
    """Return a square of right-angled triangles; diagonals parallel or alternating."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij"))
    positions = SIDE_M / count * np.stack([i, j, 0.0 * i], axis=1)
    return positions, _two_per_cell(count, lambda a, b: alternating & ((a + b) % 2 == 1))


def _two_per_cell(count, falling):  # type: ignore[no-untyped-def]
    a, b = (axis.ravel() for axis in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    p, q, r, s = ((a + da) * (count + 1) + b + db for da, db in ((0, 0), (1, 0), (1, 1), (0, 1)))
    down = falling(a, b)[:, None]
    first = np.where(down, np.stack([p, q, s], 1), np.stack([p, q, r], 1))
    second = np.where(down, np.stack([q, r, s], 1), np.stack([p, r, s], 1))
    return np.concatenate([first, second])


def hinge_energy(x: Array, hinges: IntArray, stiffness: Array) -> float:
    rest, none = np.full(len(hinges), np.pi), np.zeros((0, 0), np.int64)
    empty = np.zeros((1, 3, 3))
    springs, angles = HingeRows(hinges, stiffness, rest, 0.0), Remembered(rest, np.zeros(len(hinges)))
    energy: float = add_hinges(x, springs, angles, none, np.zeros_like(x), empty)
    return energy


def on_cylinder(flat: Array, radius: float, direction: float) -> Array:
    """Return a flat sheet rolled without stretch onto a cylinder; curved along a direction [rad]."""
    cosine, sine = np.cos(direction), np.sin(direction)
    u, v = flat[:, :2] @ (cosine, sine), flat[:, :2] @ (-sine, cosine)
    return np.stack([radius * np.sin(u / radius), v, radius * (1.0 - np.cos(u / radius))], axis=1)


def share_of_exact(sheet: tuple[Array, IntArray], radius: float, direction: float) -> float:
    """Return the energy on a cylinder over D A / (2 R^2)."""
    flat, triangles = sheet
    hinges = interior_hinges(triangles)
    stiffness = shell_stiffness(flat, triangles, hinges, RIGIDITY_Nm)
    energy = hinge_energy(on_cylinder(flat, radius, direction), hinges, stiffness)
    return energy / (0.5 * RIGIDITY_Nm / radius**2 * float(triangle_area(flat, triangles).sum()))


@pytest.mark.parametrize("direction", [0.0, 0.3, 0.5 * np.pi, 2.0])
def test_refined_sheet_bends_like_a_plate(direction: float) -> None:
    # Inside, every direction is exact but for (h / R)^2; along the rim triangles lack a hinge. So the error
    # falls with h; it is near 10 % at 8 triangles along the side.
    sheets = [equilateral_sheet(count) for count in (8, 16, 32, 64)]
    errors = [abs(share_of_exact(sheet, 0.05, direction) - 1.0) for sheet in sheets]
    assert errors[0] < 0.12
    assert all(fine < 0.52 * coarse for coarse, fine in pairwise(errors))


def test_equilateral_hinges_have_the_known_stiffness() -> None:
    flat, triangles = equilateral_sheet(9)
    hinges = interior_hinges(triangles)
    stiffness = shell_stiffness(flat, triangles, hinges, RIGIDITY_Nm)
    assert np.median(stiffness) == pytest.approx(2.0 / np.sqrt(3.0) * RIGIDITY_Nm, rel=1e-12)


@pytest.mark.parametrize(("alternating", "low", "high"), [(False, 0.5, 2.0), (True, 0.875, 1.125)])
def test_right_angled_triangles_are_right_on_the_mean(alternating: bool, low: float, high: float) -> None:
    sheet = square_sheet(24, alternating)
    directions = np.linspace(0.0, np.pi, 24, endpoint=False)
    shares = np.array([share_of_exact(sheet, 1.0, direction) for direction in directions])
    assert shares.mean() == pytest.approx(1.0, abs=1e-3)  # curvature: (h / R)^2
    # the rim is 4 % of the hinges
    assert shares.min() == pytest.approx(low, abs=0.02)
    assert shares.max() == pytest.approx(high, abs=0.02)


def test_angles_are_those_of_a_bent_sheet() -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        flat = np.array([[0.0, 0.01, 0.0], [-0.006, 0.0, 0.0], [0.005, 0.001, 0.0], [0.0, -0.008, 0.0]])
        flat[:, :2] += 2e-3 * random.normal(size=(4, 2))
        hinge = np.array([[0, 1, 2, 3]])
        radius, directions = 100.0, np.linspace(0.0, np.pi, 60, endpoint=False)
        energies = [hinge_energy(on_cylinder(flat, radius, d), hinge, np.ones(1)) for d in directions]
        # sampled mean of a quartic of the direction is exact; angles of 1e-4 are rounded to 1e-14
        mean = 2.0 * np.mean(energies) * radius**2
        assert mean == pytest.approx(float(mean_square_angle(flat, hinge)[0]), rel=1e-5)


@pytest.mark.parametrize("levels", [0, 1, 2])
def test_the_shell_rule_keeps_the_measure_of_any_mesh(levels: int) -> None:
    mesh = refine(_unit(), levels)
    hinges = interior_hinges(mesh.triangles, mesh.seam)
    stiffness = shell_stiffness(mesh.positions, mesh.triangles, hinges, RIGIDITY_Nm)
    area = float(triangle_area(mesh.positions, mesh.triangles).sum())
    assert float(hinge_areas(mesh.positions, mesh.triangles, hinges).sum()) == pytest.approx(area, rel=1e-12)
    assert bending_measure(mesh.positions, hinges, stiffness) == pytest.approx(RIGIDITY_Nm * area, rel=1e-12)


def test_folding_the_drawn_shape_or_turning_it_changes_nothing() -> None:
    # the measure is that of the unfolded pair of triangles
    flat = np.array([[0.002, 0.01, 0.0], [-0.006, 0.0, 0.0], [0.005, 0.0, 0.0], [0.001, -0.008, 0.0]])
    hinge = np.array([[0, 1, 2, 3]])
    folded = flat.copy()
    folded[3] = (0.001, -0.008 * np.cos(2.5), 0.008 * np.sin(2.5))
    expected = mean_square_angle(flat, hinge)
    assert mean_square_angle(folded, hinge) == pytest.approx(expected, rel=1e-13)
    assert mean_square_angle(folded, hinge[:, ::-1]) == pytest.approx(expected, rel=1e-13)
    assert mean_square_angle(3.0 * folded + 1.0, hinge) == pytest.approx(9.0 * expected, rel=1e-12)


def test_a_hinge_off_the_mesh_is_named() -> None:
    flat, triangles = equilateral_sheet(2)
    hinges = np.concatenate([interior_hinges(triangles), [[0, 1, 8, 2]]])
    with pytest.raises(MeshError, match=r"edge \[1, 8\]"):
        shell_stiffness(flat, triangles, hinges, RIGIDITY_Nm)
    assert len(shell_stiffness(flat, triangles, np.zeros((0, 4), np.int64), RIGIDITY_Nm)) == 0


def _unit() -> NamedMesh:
    return PolygonalStack(6, 1, 0.05, 0.01, 0.002).mesh()
