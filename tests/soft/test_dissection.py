"""Nested dissection of large meshes: the tree it makes, and the factorisation along it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.geometry.named_mesh import refine
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.linear import cholesky as dissected_cholesky
from cosim.soft.linear.cholesky import DissectedCholesky, EnvelopeCholesky, cholesky
from cosim.soft.linear.dissection import dissect, least_cuts
from cosim.soft.linear.fronts import FrontTree, length_left
from cosim.soft.linear.linear_solver import LinearSolver
from cosim.soft.linear.pattern import CoupledPattern
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


def assembled() -> tuple[FilmPotential, Mask]:
    """Return the system of the refined arm with a definite tangent, base held."""
    body = refined_arm()
    system, free = FilmPotential(body), np.ones((body.nodes, 3), dtype=bool)
    free[body.base] = False
    free[body.tip[0], 2] = False  # and one component alone
    x, loads = body.positions, Loads((), (1.0, 1.0))
    bed = Inertia(np.full(body.nodes, 500.0), x)
    system.evaluate(x, loads, system.losses_at(x, loads), system.memory, inertia=bed)
    return system, free


def tree_of(graph: csr_matrix, groups: list[IntArray]) -> FrontTree:
    """Return the fronts of groups of nodes with one component each."""
    nodes = graph.shape[0]
    number = np.full((nodes, 3), -1)
    number[np.concatenate(groups), 1] = np.arange(nodes)
    return FrontTree.of(graph, groups, number)


def test_every_node_is_eliminated_once_and_its_ties_are_handed_on() -> None:
    graph = grid()
    groups = dissect(graph, np.array([0, SIDE * SIDE - 1]), 16)
    assert sorted(np.concatenate(groups)) == list(range(SIDE * SIDE))
    assert max(len(group) for group in groups) == 16
    tree, order = tree_of(graph, groups), np.concatenate(groups)
    rank = np.argsort(order)
    rests = np.split(tree.rest, tree.rest_first[1:-1])
    parents = np.full(len(groups), -1)
    for k, children in enumerate(np.split(tree.children, tree.child_first[1:-1])):
        parents[children] = k
    for k, (group, rest) in enumerate(zip(groups, rests, strict=True)):
        neighbours = rank[np.unique(graph[group].indices)]
        assert set(neighbours[neighbours >= tree.first[k + 1]]) <= set(rest)
        assert (np.diff(rest) > 0).all()
        if len(rest):
            parent = parents[k]
            own = np.arange(tree.first[parent], tree.first[parent + 1])
            there = np.concatenate([own, rests[parent]])
            assert parent > k
            assert rest[0] in own
            assert (there[tree.rows[tree.rest_first[k] : tree.rest_first[k + 1]]] == rest).all()
        else:
            assert parents[k] == -1


def test_what_is_left_of_fronts_that_wait_does_not_overlap() -> None:
    tree = tree_of(grid(), dissect(grid(), np.zeros(0, np.int64), 16))
    waiting: dict[int, tuple[int, int]] = {}
    for k, count in enumerate(np.diff(tree.rest_first)):
        mine = int(tree.left[k]), int(tree.left[k]) + length_left(int(count))
        assert mine[1] <= tree.stack
        assert all(mine[1] <= begin or end <= mine[0] for begin, end in waiting.values() if begin < end)
        for child in tree.children[tree.child_first[k] : tree.child_first[k + 1]]:
            del waiting[int(child)]
        waiting[k] = mine


def test_a_grid_is_cut_by_no_more_than_its_side_and_fill_stays_low() -> None:
    graph = grid()
    tree = tree_of(graph, dissect(graph, np.zeros(0, np.int64), SIDE))
    assert tree.first[-1] - tree.first[-2] <= SIDE
    own, rest = np.diff(tree.first), np.diff(tree.rest_first)
    # the band as numbered would hold SIDE entries in each of SIDE^2 rows
    assert (own * (own + rest)).sum() < SIDE**3


def test_what_is_tied_across_the_mesh_does_not_blur_the_cuts() -> None:
    graph = grid()
    eyelets = np.arange(0, SIDE * SIDE, 5 * SIDE)  # a cable along one edge
    row, column = eyelets[:-1], eyelets[1:]
    ties = csr_matrix((np.ones(len(row)), (row, column)), shape=graph.shape)
    groups = dissect((graph + ties + ties.T).tocsr(), eyelets, SIDE + 2)
    assert len(groups[-1]) <= SIDE + 1


def test_the_cut_parts_what_a_tie_holds_together_from_end_to_end() -> None:
    graph, ends = grid().tolil(), np.array([0, SIDE - 1, SIDE * (SIDE - 1), SIDE * SIDE - 1])
    for end in ends:
        graph[end, np.setdiff1d(ends, end)] = 1.0
    tied = graph.tocsr()
    kept = np.setdiff1d(np.arange(SIDE * SIDE), dissect(tied, ends, SIDE + 2)[-1])
    assert connected_components(tied[kept][:, kept], directed=False)[0] > 1


def test_the_least_cut_goes_through_the_neck() -> None:
    graph = grid().tolil()
    wall = np.arange(SIDE) + 30 * SIDE  # a row of the grid, but for a gate of three
    gate = wall[20:23]
    for node in np.setdiff1d(wall, gate):
        graph[node, :] = 0
        graph[:, node] = 0
    node = np.arange(SIDE * SIDE)
    first, last = least_cuts(graph.tocsr(), node < 10 * SIDE, node >= 50 * SIDE)
    assert set(first) == set(gate)
    assert len(last) == 3


def test_the_factor_of_a_refined_arm_solves_like_that_within_the_envelope() -> None:
    system, free = assembled()
    solver = DissectedCholesky(system.pattern, free, system.tied)
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


def test_a_wider_pattern_takes_over_the_order_of_elimination() -> None:
    system, free = assembled()
    near = DissectedCholesky(system.pattern, free, system.tied)
    touching = np.array([[60, 300, 310, 320], [70, 400, 410, 420]])
    wide = CoupledPattern.of(system.pattern, touching)
    blocks = wide.blocks(system.blocks)
    for a, b in ((0, 1), (2, 3)):
        one, two = touching[:, a], touching[:, b]
        at = wide.pattern.row * wide.pattern.nodes + wide.pattern.column
        blocks[np.searchsorted(at, np.maximum(one, two) * wide.pattern.nodes + np.minimum(one, two))] = 7.0
    solver = cholesky(wide.pattern, free, system.tied, near)
    assert isinstance(solver, DissectedCholesky)
    assert solver.groups is near.groups
    envelope = EnvelopeCholesky(wide.pattern, free)
    load: Array = np.random.default_rng(1).normal(size=(system.body.nodes, 3))
    assert solver.factor(blocks)
    assert envelope.factor(blocks)
    expected = envelope.solve(load)
    assert solver.solve(load) == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())


def test_patterns_that_touch_are_dissected_once(monkeypatch: pytest.MonkeyPatch) -> None:
    system, free = assembled()
    made: list[int] = []

    def counted(*arguments: Any) -> list[IntArray]:
        made.append(1)
        return dissect(*arguments)

    monkeypatch.setattr(dissected_cholesky, "dissect", counted)
    alone = EnvelopeCholesky(system.pattern, free)
    monkeypatch.setattr(dissected_cholesky, "_WIDEST_ENVELOPE", 0)
    groups = []
    for far in (300, 400):
        wide = CoupledPattern.of(system.pattern, np.array([[60, far]])).pattern
        solver = cholesky(wide, free, system.tied, alone)
        assert isinstance(solver, DissectedCholesky)
        groups.append(solver.groups)
    assert groups[0] is groups[1]
    assert len(made) == 1


def test_a_saved_factor_is_not_written_to() -> None:
    system, free = assembled()
    solver = DissectedCholesky(system.pattern, free, system.tied)
    loads = np.ones((system.body.nodes, 3))
    solver.factor(system.blocks)
    expected, saved = solver.solve(loads), solver.state
    solver.factor(2.0 * system.blocks)
    assert solver.solve(loads) == pytest.approx(0.5 * expected)
    solver.state = saved
    assert (solver.solve(loads) == expected).all()
    solver.factor(2.0 * system.blocks)
    solver.state = saved
    assert (solver.solve(loads) == expected).all()


@pytest.mark.parametrize(("bound", "kind"), [(400, EnvelopeCholesky), (100, DissectedCholesky)])
def test_a_wide_envelope_is_dissected_a_narrow_one_kept(
    monkeypatch: pytest.MonkeyPatch, bound: int, kind: type[LinearSolver]
) -> None:
    system = FilmPotential(refined_arm(8))  # 137 entries in a row
    free = np.ones((system.body.nodes, 3), dtype=bool)
    monkeypatch.setattr(dissected_cholesky, "_WIDEST_ENVELOPE", bound)
    assert isinstance(cholesky(system.pattern, free, system.tied), kind)
