"""Nested dissection of large meshes: the tree it makes, and the factorisation along it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from cosim.frames import Array, Mask
from cosim.soft import dissected_cholesky
from cosim.soft.body import Loads, SoftBody
from cosim.soft.chamber import PolygonalStack
from cosim.soft.dissected_cholesky import DissectedCholesky, cholesky
from cosim.soft.dissection import dissect
from cosim.soft.envelope_cholesky import EnvelopeCholesky
from cosim.soft.linear_solver import LinearSolver
from cosim.soft.refinement import refine
from cosim.soft.surface import interior_hinges
from cosim.soft.system import Inertia, SoftSystem
from tests.soft.bodies import FILM, hexagon_arm

SIDE = 60


def grid() -> csr_matrix:
    """Return the graph of a square grid of nodes, each tied to its eight neighbours."""
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:]), (number[:-1, :-1], number[1:, 1:]),
             (number[1:, :-1], number[:-1, 1:])]  # fmt: skip
    row, column = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
    half = csr_matrix((np.ones(len(row)), (row, column)), shape=(SIDE * SIDE,) * 2)
    return (half + half.T).tocsr()


def refined_arm(units: int = 3) -> SoftBody:
    """Return units with cables, every triangle divided into four."""
    mesh = refine(PolygonalStack(6, units, 0.05, 0.01, 0.002, 0.95).mesh(), 1)
    coarse = hexagon_arm(units)
    return SoftBody.from_arrays(
        mesh.positions, mesh.triangles, FILM, hinge_nodes=interior_hinges(mesh.triangles, mesh.seam),
        hinge_stiffness=0.01, caps=mesh.caps, node_mass=1e-3, cables=coarse.cables, tip=mesh.ring("tip"),
        base=mesh.ring("unit_1.hole"),
    )  # fmt: skip


def assembled() -> tuple[SoftSystem, Mask]:
    """Return the system of the refined arm with a definite tangent, base held."""
    body = refined_arm()
    system, free = SoftSystem(body), np.ones((body.nodes, 3), dtype=bool)
    free[body.base] = False
    free[body.tip[0], 2] = False  # and one component alone
    x, loads = body.positions, Loads(0.0, (1.0, 1.0))
    bed = Inertia(np.full(body.nodes, 500.0), x)
    system.evaluate(x, loads, system.segment_tension(x, loads), system.angles, inertia=bed)
    return system, free


def test_every_node_is_eliminated_once_and_its_ties_are_handed_on() -> None:
    graph, last = grid(), np.array([0, SIDE * SIDE - 1])
    fronts = dissect(graph, last)
    assert sorted(np.concatenate([front.nodes for front in fronts])) == list(range(SIDE * SIDE))
    assert (fronts[-1].nodes == last).all()
    owner = np.empty(SIDE * SIDE, dtype=int)
    for k, front in enumerate(fronts):
        owner[front.nodes] = k
    for k, front in enumerate(fronts):
        neighbours = np.unique(graph[front.nodes].indices)
        assert set(neighbours[owner[neighbours] > k]) <= set(front.rest)
        if len(front.rest):
            parent = fronts[front.parent]
            assert set(front.rest) <= set(parent.nodes) | set(parent.rest)
            assert owner[front.rest[0]] == front.parent > k
        else:
            assert front.parent == -1


def test_no_front_is_much_wider_than_the_grid() -> None:
    # the band as numbered would hold SIDE entries in each of SIDE^2 rows
    fronts = dissect(grid(), np.zeros(0, np.int64))
    assert max(len(front.nodes) + len(front.rest) for front in fronts) <= 3 * SIDE
    assert sum(len(front.nodes) * (len(front.nodes) + len(front.rest)) for front in fronts) < SIDE**3


def test_the_factor_of_a_refined_arm_solves_like_that_within_the_envelope() -> None:
    system, free = assembled()
    solver = DissectedCholesky(system.pattern, free, system.eyelets)
    envelope = EnvelopeCholesky(system.pattern, free)
    loads: Array = np.random.default_rng(0).normal(size=(system.body.nodes, 3))
    for shift in (0.0, 300.0):
        assert solver.factor(system.blocks, shift)
        assert envelope.factor(system.blocks, shift)
        expected = envelope.solve(loads)
        assert solver.solve(loads) == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())
        assert not solver.solve(loads)[~free].any()
    weak = system.blocks.copy()
    weak[np.flatnonzero(system.pattern.row == system.pattern.column)[100]] -= 1e6 * np.eye(3)
    assert not solver.factor(weak)
    assert not solver.factor(np.nan * weak)


def test_a_saved_factor_is_not_written_to() -> None:
    system, free = assembled()
    solver = DissectedCholesky(system.pattern, free, system.eyelets)
    loads = np.ones((system.body.nodes, 3))
    solver.factor(system.blocks)
    expected, saved = solver.solve(loads), solver.save_state()
    solver.factor(2.0 * system.blocks)
    assert solver.solve(loads) == pytest.approx(0.5 * expected)
    solver.restore_state(saved)
    assert (solver.solve(loads) == expected).all()
    solver.factor(2.0 * system.blocks)
    solver.restore_state(saved)
    assert (solver.solve(loads) == expected).all()


@pytest.mark.parametrize(("bound", "kind"), [(400, EnvelopeCholesky), (100, DissectedCholesky)])
def test_a_wide_envelope_is_dissected_a_narrow_one_kept(
    monkeypatch: pytest.MonkeyPatch, bound: int, kind: type[LinearSolver]
) -> None:
    system = SoftSystem(refined_arm(8))  # 137 entries in a row
    free = np.ones((system.body.nodes, 3), dtype=bool)
    monkeypatch.setattr(dissected_cholesky, "_WIDEST_ENVELOPE", bound)
    assert isinstance(cholesky(system.pattern, free, system.eyelets), kind)
