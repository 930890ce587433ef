"""Sparse Cholesky by fronts: for meshes whose envelope would be wide.

Front k eliminates its components p and hands the rest q on to its parent:

    A_pp = L L^T,   W = A_qp L^-T,   U = A_qq - W W^T.

L^-1 is kept instead of L: fronts are narrow, and products with it are what processors are fast at.
Source: Duff and Reid, ACM Trans. Math. Software 9 (1983) 302 (the multifrontal method).
"""

from __future__ import annotations

import logging
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from cosim.base.compilation import compile_modules
from cosim.base.frames import Array, IntArray, Mask
from cosim.base.state_check import KnownStates, check_state
from cosim.soft.linear import multifrontal_kernels
from cosim.soft.linear.elimination_tree import COLUMNS, FrontTree, dissect
from cosim.soft.linear.envelope_cholesky import EnvelopeCholesky
from cosim.soft.linear.linear_solver import LinearSolver, equations, lower_entries, numbering
from cosim.soft.linear.multifrontal_kernels import FrontLists, FrontRoom, factorise, substitute
from cosim.soft.linear.pattern import BlockPattern

# Entries of a row on average. At 137 fronts take 1.2 times as long as the envelope, at 287 half as long; a
# solution takes 1.2 and 0.7 times as long.
_WIDEST_ENVELOPE = 200
_FRONT_NODES = 12  # eliminated in one go


def cholesky(
    pattern: BlockPattern, free: Mask, far: IntArray, like: LinearSolver | None = None
) -> LinearSolver:
    """Return the faster of both ways for a symmetric matrix.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, world components that can move.
        far: nodes that are tied together across the mesh.
        like: solver of the same components with fewer ties, whose order of elimination is taken over.
    """
    if not isinstance(like, DissectedCholesky):
        envelope = EnvelopeCholesky(pattern, free, like if isinstance(like, EnvelopeCholesky) else None)
        if envelope.mean_width <= _WIDEST_ENVELOPE:
            return envelope
    if like is not None and like.groups is None:
        like.groups = _dissected(like, far)
    return DissectedCholesky(pattern, free, far, None if like is None else like.groups)


def _graph(solver: LinearSolver) -> csr_matrix:
    """Return which free nodes a solver's pattern ties to one another."""
    pattern, movable = solver.pattern, np.asarray(solver.free.any(axis=1))
    local = np.cumsum(movable) - 1
    kept = movable[pattern.row] & movable[pattern.column] & (pattern.row != pattern.column)
    rows, columns = local[pattern.row[kept]], local[pattern.column[kept]]
    half = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(solver.free_nodes),) * 2)
    return (half + half.T).tocsr()


def _dissected(solver: LinearSolver, far: IntArray | None) -> list[IntArray]:
    """Return a solver's free nodes in the order of a nested dissection, in groups."""
    movable = np.asarray(solver.free.any(axis=1))
    local = np.cumsum(movable) - 1
    tied = np.zeros(0, np.int64) if far is None else local[far[movable[far]]]
    return dissect(_graph(solver), tied, _FRONT_NODES)


@final
class DissectedCholesky(LinearSolver):
    """Cholesky in the order of a nested dissection; refuses an indefinite matrix.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
        far: nodes that are tied together across the mesh.
        groups: of free nodes in the order of elimination; found if not given.
    """

    def __init__(
        self,
        pattern: BlockPattern,
        free: Mask,
        far: IntArray | None = None,
        groups: list[IntArray] | None = None,
    ) -> None:
        super().__init__(pattern, free)
        compile_modules(logging.getLogger("cosim").info, (multifrontal_kernels,))
        self.groups = groups = _dissected(self, far) if groups is None else groups
        number = numbering(self.free, self.free_nodes[np.concatenate(groups)])
        self._dofs = equations(number)
        self._tree = FrontTree.of(_graph(self), groups, number[self.free_nodes])
        self._place_entries(number)
        tree, own = self._tree, np.diff(self._tree.first)
        count = np.diff(tree.rest_first)
        widest = int(own.max())
        length = int((own * (own + count)).max())
        self._work, self._spare = np.empty(length), np.empty(length + 2 * widest)
        self._here, self._there = np.empty(widest), np.empty(max(widest, COLUMNS))
        self._stack = np.empty(tree.stack)
        self._store = np.empty(int(tree.start[-1]))
        self._lent = False
        self._known = KnownStates()

    def _place_entries(self, number: IntArray) -> None:
        """Find where each entry of the matrix goes, front by front."""
        tree = self._tree
        row, column, source = lower_entries(self.pattern, number)
        front, place = tree.place(row, column)
        order = np.lexsort((place, front))
        self._source, self._place = (part[order].astype(np.uint64) for part in (source, place))
        entry_first = np.searchsorted(front[order], np.arange(len(tree.first)))
        starts = (tree.first, tree.start, tree.rest_first, tree.child_first, tree.run_first, entry_first)
        fronts = np.stack([*starts, np.append(tree.left, 0)], axis=1)
        lists = (part.astype(np.uint64) for part in (fronts, tree.children, tree.runs, tree.rows))
        self._lists, self._rest = FrontLists(*lists), tree.rest.astype(np.uint64)

    def _factorise(self, blocks: Array, shift: float) -> bool:
        if self._lent:
            self._store, self._lent = np.empty_like(self._store), False
        room = FrontRoom(self._work, self._spare, self._stack, self._store)
        return bool(factorise(blocks.reshape(-1), self._source, self._place, shift, self._lists, room))

    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        self._lent = True
        self._known.add(self._store)
        return (self._store,)

    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if parts[0] not in self._known:
            check_state(parts, (self._store,), place="state.soft.newton.factor.parts")
        (self._store,) = parts
        self._lent = True
        self._known.add(self._store)

    def _solve_sparse(self, loads: Array) -> Array:
        result = np.zeros((len(loads), 3 * self.pattern.nodes))
        for load, found in zip(loads.reshape(len(loads), -1), result, strict=True):
            x = load[self._dofs]
            substitute(self._store, self._lists.fronts, self._rest, self._here, self._there, x)
            found[self._dofs] = x
        return result.reshape(len(loads), -1, 3)
