"""Direct solvers against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, rotation_from_vector
from cosim.errors import InputError, SolverError
from cosim.soft.elements.open_caps import OpenCapSolver
from cosim.soft.linear.cholesky import DissectedCholesky, EnvelopeCholesky
from cosim.soft.linear.factor import Factor
from cosim.soft.linear.linear_solver import (
    FactorState,
    GeneralLU,
    LinearSolver,
    Tangent,
    by_component,
    negative_pivots,
)
from cosim.soft.linear.pattern import BlockPattern, PatternWidening
from tests.derivatives import dense

NODES = 14
ELEMENTS = [
    np.array([[0, 5, 9], [13, 2, 7], [5, 7, 1], [11, 3, 4], [9, 13, 8], [6, 10, 12]]),
    np.array([[12, 0], [4, 8], [10, 3]]),
]
SOLVERS = [EnvelopeCholesky, DissectedCholesky, GeneralLU]


def definite(pattern: BlockPattern) -> tuple[Array, Array]:
    """Return blocks of a positive definite matrix with the pattern, and the matrix (3 n, 3 n)."""
    blocks = np.random.default_rng(0).normal(size=(pattern.blocks, 3, 3))
    same = pattern.row == pattern.column
    blocks[same] = blocks[same] + blocks[same].transpose(0, 2, 1) + 25.0 * np.eye(3)
    return blocks, dense(pattern, blocks)


def problem() -> tuple[BlockPattern, Array, Array, Array, Array, Array]:
    pattern = BlockPattern.from_elements(NODES, ELEMENTS)
    free = np.ones(NODES, dtype=bool)
    free[[2, 9]] = False
    blocks, matrix = definite(pattern)
    return pattern, free, blocks, matrix, np.repeat(free, 3), np.random.default_rng(1).normal(size=(NODES, 3))


@pytest.mark.parametrize("kind", SOLVERS)
@pytest.mark.parametrize("shift", [0.0, 7.0])
def test_solvers_agree_with_dense_algebra(kind: type[LinearSolver], shift: float) -> None:
    pattern, free, blocks, matrix, dofs, load = problem()
    solver = kind(pattern, free)
    assert solver.size == dofs.sum()
    assert solver.factor(blocks, shift)
    inner = matrix[np.ix_(dofs, dofs)] + shift * np.eye(dofs.sum())
    expected = np.linalg.solve(inner, load.ravel()[dofs])
    found = solver.solve(load)
    assert found.ravel()[dofs] == pytest.approx(expected, rel=1e-12, abs=1e-13)
    assert not found[~free].any()


@pytest.mark.parametrize("kind", SOLVERS)
def test_a_factor_is_replaced_by_the_next(kind: type[LinearSolver]) -> None:
    pattern, free, blocks, matrix, dofs, load = problem()
    solver = kind(pattern, free)
    solver.factor(blocks, 3.0)
    solver.factor(2.0 * blocks)
    expected = np.linalg.solve(2.0 * matrix[np.ix_(dofs, dofs)], load.ravel()[dofs])
    assert solver.solve(load).ravel()[dofs] == pytest.approx(expected, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("kind", SOLVERS[:2])
def test_cholesky_refuses_an_indefinite_matrix_until_the_shift_suffices(kind: type[LinearSolver]) -> None:
    pattern, free, blocks, matrix, dofs, _ = problem()
    blocks[pattern.row == pattern.column] -= 40.0 * np.eye(3)
    lowest = np.linalg.eigvalsh(matrix[np.ix_(dofs, dofs)]).min() - 40.0
    solver = kind(pattern, free)
    assert lowest < 0.0
    assert not solver.factor(blocks)
    assert not solver.factor(blocks, 0.99 * -lowest)
    assert solver.factor(blocks, 1.01 * -lowest)


@pytest.mark.parametrize("turned", [False, True])
def test_a_step_in_single_precision_is_that_in_double(turned: bool) -> None:
    """Up to the rounding of single precision, also of the factorisation after the first."""
    pattern, free, blocks, _, _, load = problem()
    factor = Factor(lambda own, _: EnvelopeCholesky(own, free), pattern, by_component(free))
    frame = rotation_from_vector(np.array([0.3, -0.2, 0.1])) if turned else np.eye(3)
    for scale in (1.0, 2.0):
        assert factor.make(Tangent(pattern, scale * blocks), 1.0, np.eye(3), (1e-3, 1.0)) == 1
        steps = np.empty((2, *load.shape))
        for step, roughly in zip(steps, (False, True), strict=True):
            longest = factor.step(load, frame, step, roughly=roughly)
            assert longest == np.abs(step).max()
        off = np.abs(steps[1] - steps[0]).max()
        assert 0.0 < off < 1e-4 * np.abs(steps[0]).max()


def unsymmetric(shift: float) -> tuple[OpenCapSolver, Array, Array, Array]:
    """Return a solver whose matrix has an unsymmetric part and is definite or not, a load and its answer."""
    pattern, free, blocks, matrix, dofs, load = problem()
    nodes = np.array([7, 2, 12])  # one of them clamped
    part = np.random.default_rng(2).normal(size=(9, 9))
    blocks[pattern.row == pattern.column] += shift * np.eye(3)
    solver = OpenCapSolver(pattern, free, np.zeros(0, np.int64))
    solver.extra = [(nodes, part)]
    assert solver.factor(blocks)
    places = (3 * nodes[:, None] + np.arange(3)).ravel()
    matrix[np.ix_(places, places)] += part
    matrix += shift * np.eye(len(matrix))
    expected = np.zeros(load.size)
    expected[dofs] = np.linalg.solve(matrix[np.ix_(dofs, dofs)], load.ravel()[dofs])
    return solver, blocks, load, expected


@pytest.mark.parametrize("shift", [0.0, -40.0])
def test_unsymmetric_parts_go_beside_cholesky_or_into_a_general_factor(shift: float) -> None:
    solver, blocks, load, expected = unsymmetric(shift)
    assert solver.solve(load).ravel() == pytest.approx(expected, rel=1e-11, abs=1e-13)
    general = GeneralLU(solver.pattern, solver.free)
    general.extra = solver.extra
    assert general.factor(blocks)
    assert solver.solve(load) == pytest.approx(general.solve(load), rel=1e-10, abs=1e-13)


@pytest.mark.parametrize("shift", [0.0, -40.0])
def test_a_factor_with_unsymmetric_parts_is_saved(shift: float) -> None:
    solver, blocks, load, expected = unsymmetric(shift)
    saved = solver.state
    assert (len(saved.parts) == 3) is (shift < 0.0)  # a general factor
    assert solver.factor(3.0 * blocks)
    for other in (solver, OpenCapSolver(solver.pattern, solver.free, np.zeros(0, np.int64))):
        other.state = saved
        assert other.solve(load).ravel() == pytest.approx(expected, rel=1e-11, abs=1e-13)
    alone = FactorState((saved.parts[0], np.zeros((1, 1)), *saved.parts[2:]), None)
    with pytest.raises(InputError):
        solver.state = alone


def test_the_order_keeps_the_envelope_narrow() -> None:
    # a hub that is numbered first would fill the whole triangle: 60 of 120 entries in a row
    spokes = np.stack([np.zeros(39, np.int64), np.arange(1, 40)], axis=1)
    solver = EnvelopeCholesky(BlockPattern.from_elements(40, [spokes]), np.ones(40, dtype=bool))
    assert solver.mean_width < 24.0


@pytest.mark.parametrize("kind", SOLVERS[:2])
def test_a_node_without_stiffness_is_not_definite_and_a_shift_helps(kind: type[LinearSolver]) -> None:
    pattern = BlockPattern.from_elements(3, [np.array([[0, 1]])])  # node 2 hangs on nothing
    blocks = np.zeros((pattern.blocks, 3, 3))
    blocks[(pattern.row == pattern.column) & (pattern.row < 2)] = np.eye(3)
    solver = kind(pattern, np.ones(3, dtype=bool))
    assert not solver.factor(blocks)
    assert solver.factor(blocks, 0.5)
    assert solver.solve(np.ones((3, 3)))[2] == pytest.approx([2.0, 2.0, 2.0])


def test_pattern_holds_each_pair_once_and_finds_it_both_ways() -> None:
    pattern = BlockPattern.from_elements(5, [np.array([[3, 1, 0], [1, 3, 4]]), np.zeros((0, 2), np.int64)])
    pairs = set(zip(pattern.row.tolist(), pattern.column.tolist(), strict=True))
    assert pairs == {(k, k) for k in range(5)} | {(1, 0), (3, 0), (3, 1), (4, 1), (4, 3)}
    assert pattern.blocks == len(pairs)
    slots = pattern.slots(np.array([[3, 1], [1, 3]]))
    forward, backward = slots[1, 1], slots[0, 1]  # row after column, and the pair named the other way
    assert forward >= 0 > backward
    assert forward == -1 - backward
    assert (pattern.row[forward], pattern.column[forward]) == (3, 1)


@pytest.mark.parametrize("kind", SOLVERS)
def test_a_singular_matrix_is_refused_and_a_shift_helps(kind: type[LinearSolver]) -> None:
    pattern, free, blocks, _, dofs, load = problem()
    solver = kind(pattern, free)
    assert not solver.factor(0.0 * blocks)
    assert solver.factor(0.0 * blocks, 2.0)
    assert solver.solve(load).ravel()[dofs] == pytest.approx(0.5 * load.ravel()[dofs])


def wide_pairs(pattern: BlockPattern) -> set[tuple[int, int]]:
    return set(zip(pattern.row.tolist(), pattern.column.tolist(), strict=True))


def test_a_wider_pattern_is_kept_while_it_serves_and_most_of_it_is_needed() -> None:
    ring = np.stack([np.arange(60), (np.arange(60) + 1) % 60], axis=1)
    body = BlockPattern.from_elements(60, [ring])
    widening = PatternWidening(body)
    touching = np.array([[3, 30], [4, 31], [5, 32]])
    wide = widening.around(touching, body)
    assert wide_pairs(wide.pattern) == wide_pairs(body) | {(30, 3), (31, 4), (32, 5)}
    assert (wide.from_body == np.searchsorted(wide.pattern._key, body._key)).all()
    # fewer pairs, in a pattern that a saved state has brought back
    again = BlockPattern(60, wide.pattern.row.copy(), wide.pattern.column.copy())
    assert PatternWidening(body).around(touching[1:], again).pattern is again
    # another pair: those before stay
    more = widening.around(np.array([[6, 33]]), wide.pattern)
    assert wide_pairs(more.pattern) == wide_pairs(wide.pattern) | {(33, 6)}
    # but not where they would be a good part of it
    far = np.stack([np.arange(20), np.arange(20) + 25], axis=1)
    many = widening.around(far, more.pattern)
    few = widening.around(np.array([[6, 33]]), many.pattern)
    assert wide_pairs(few.pattern) == wide_pairs(body) | {(33, 6)}


def test_pairs_that_a_pattern_does_not_hold_are_counted() -> None:
    pattern = BlockPattern.from_elements(5, [np.array([[3, 1, 0]])])
    assert pattern.find(np.array([[3, 1]]))[1] == 0
    assert pattern.find(np.array([[3, 4], [4, 2]]))[1] == 2


def test_negative_eigenvalues_are_counted_and_a_slack_film_is_named() -> None:
    pattern, free, blocks, _matrix, dofs, _ = problem()
    blocks[pattern.row == pattern.column] -= 27.0 * np.eye(3)
    symmetric = dense(pattern, blocks)[np.ix_(dofs, dofs)]
    expected = int((np.linalg.eigvalsh(symmetric) < 0.0).sum())
    assert negative_pivots(pattern, free, blocks, None) == expected
    with pytest.raises(SolverError, match="slack: start at a pressure"):
        negative_pivots(pattern, free, 0.0 * blocks, None)
