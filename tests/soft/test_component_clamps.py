"""Clamping single components: the factorised matrix, and a mirrored half against the whole."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.linear.cholesky import DissectedCholesky, EnvelopeCholesky
from cosim.soft.linear.linear_solver import GeneralLU, LinearSolver, by_component
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions

FILM = Film(1e6, 0.3, 1e-3)


def sheet(columns: int, rows: int, left_m: float = 0.0) -> SoftBody:
    """Return a sheet from x = left to 0.2 m, 0.2 m wide; each square is cut along one diagonal."""
    x, y = np.meshgrid(np.linspace(left_m, 0.2, columns + 1), np.linspace(0.0, 0.2, rows + 1), indexing="ij")
    positions = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    rising = positions[a.ravel(), 0] >= -1e-9  # mirrored about x = 0
    first = np.where(
        rising[:, None],
        np.stack([v.ravel() for v in (a, b, c)], 1),
        np.stack([v.ravel() for v in (a, b, d)], 1),
    )
    second = np.where(
        rising[:, None],
        np.stack([v.ravel() for v in (a, c, d)], 1),
        np.stack([v.ravel() for v in (b, c, d)], 1),
    )
    return SoftBody.from_arrays(positions, np.concatenate([first, second]), FILM, node_mass=1e-3)


def some_clamps(body: SoftBody) -> Mask:
    """Return a mask that holds whole nodes, single components, and leaves most free."""
    return np.random.default_rng(1).random((body.nodes, 3)) < 0.3


@pytest.mark.parametrize("kind", [EnvelopeCholesky, DissectedCholesky, GeneralLU])
def test_the_solution_is_that_of_the_dense_matrix(kind: type[LinearSolver]) -> None:
    body = sheet(3, 3)
    system = FilmPotential(body)
    stretched = body.positions * np.array([1.05, 1.02, 1.0])
    system.evaluate(stretched, Loads(), np.zeros(0), system.memory)
    dense = np.zeros((body.nodes, 3, body.nodes, 3))
    dense[system.pattern.row, :, system.pattern.column] = system.blocks
    dense[system.pattern.column, :, system.pattern.row] = system.blocks.transpose(0, 2, 1)
    free = ~some_clamps(body)
    load = np.random.default_rng(2).normal(size=(body.nodes, 3))
    expected = np.zeros((body.nodes, 3))
    matrix = dense.reshape(3 * body.nodes, -1)[np.ix_(free.ravel(), free.ravel())]
    expected[free] = np.linalg.solve(matrix + 2.0 * np.eye(len(matrix)), load[free])

    solver = kind(system.pattern, free)
    assert solver.factor(system.blocks, 2.0)
    # condition number about 1e4: twelve digits are left
    np.testing.assert_allclose(solver.solve(load), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def hanging(body: SoftBody, clamped: Mask) -> Array:
    """Return the equilibrium under gravity, from a start that is not flat."""
    start = body.positions - np.array([0.0, 0.0, 0.05]) * ~by_component(clamped)
    loads = Loads(gravity=(0.0, 0.0, -9.81))
    system = FilmPotential(body)
    result = NewtonSolver(system, clamped).solve(start, system.memory, loads, NewtonOptions(tolerance_N=1e-9))
    assert result.converged
    return result.positions


def test_a_half_on_its_plane_of_symmetry_is_half_of_the_whole() -> None:
    whole, half = sheet(8, 4, -0.2), sheet(4, 4)
    in_plane = np.abs(half.positions[:, 0]) < 1e-9
    # a half carries half the mass of the nodes on the plane of symmetry
    mass = np.where(in_plane, 0.5e-3, 1e-3)
    half = SoftBody.from_arrays(half.positions, half.triangles, FILM, node_mass=mass)
    edge_whole = np.abs(np.abs(whole.positions[:, 0]) - 0.2) < 1e-9
    clamped = np.repeat((half.positions[:, 0] > 0.2 - 1e-9)[:, None], 3, axis=1)
    clamped[in_plane, 0] = True

    found = hanging(half, clamped)
    expected = hanging(whole, edge_whole)[whole.positions[:, 0] > -1e-9]
    assert expected[:, 2].min() < -0.01
    np.testing.assert_allclose(found, expected, atol=1e-8)
