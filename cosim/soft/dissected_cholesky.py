"""Sparse Cholesky by fronts: for meshes whose envelope would be wide.

Front k eliminates its components p and hands the rest q on to its parent:

    A_pp = L L^T,   W = A_qp L^-T,   U = A_qq - W W^T.

Source: Duff and Reid, ACM Trans. Math. Software 9 (1983) 302 (the multifrontal method).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack
from scipy.sparse import csr_matrix

from cosim.frames import Array, IntArray, Mask
from cosim.kernels import INDICES, MATRIX, VECTOR, kernel
from cosim.soft.dissection import Front, dissect
from cosim.soft.envelope_cholesky import EnvelopeCholesky
from cosim.soft.linear_solver import LinearSolver, lower_entries, scatter
from cosim.soft.pattern import BlockPattern

# Entries of a row on average. Measured: at 137 a factorisation takes 3.6 ms within the envelope and 12 ms by
# fronts, at 287 61 and 94 ms; the envelope grows faster.
_WIDEST_ENVELOPE = 400


def cholesky(pattern: BlockPattern, free: Mask, far: IntArray) -> LinearSolver:
    """Return the faster of both ways for a symmetric matrix.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, world components that can move.
        far: nodes that are tied together across the mesh.
    """
    envelope = EnvelopeCholesky(pattern, free)
    return envelope if envelope.mean_width <= _WIDEST_ENVELOPE else DissectedCholesky(pattern, free, far)


@kernel((MATRIX, MATRIX, MATRIX, INDICES, MATRIX))
def _hand_on(own, below, left, place, child):  # type: ignore[no-untyped-def]
    """Add the lower triangle of a child's remainder to a front; place[i] is its row i in the front."""
    p = own.shape[0]
    for i in range(child.shape[0]):
        row = place[i]
        for j in range(i + 1):
            column = place[j]
            if row < p:
                own[row, column] += child[i, j]
            elif column < p:
                below[row - p, column] += child[i, j]
            else:
                left[row - p, column - p] += child[i, j]


@kernel((VECTOR, INDICES, INDICES, INDICES, INDICES, VECTOR))
def _substitute(store, start, first, rest_first, rest, x):  # type: ignore[no-untyped-def]
    """Solve for x (size,) in place, components in the order of elimination: front k owns x[first[k]:]."""
    fronts = start.shape[0]
    for k in range(fronts):
        a, p = first[k], first[k + 1] - first[k]
        for i in range(p):
            row = start[k] + i * p
            total = x[a + i]
            for j in range(i):
                total -= store[row + j] * x[a + j]
            x[a + i] = total / store[row + i]
        for r in range(rest_first[k], rest_first[k + 1]):
            row = start[k] + (p + r - rest_first[k]) * p
            total = 0.0
            for j in range(p):
                total += store[row + j] * x[a + j]
            x[rest[r]] -= total
    for k in range(fronts - 1, -1, -1):
        a, p = first[k], first[k + 1] - first[k]
        for r in range(rest_first[k], rest_first[k + 1]):
            row = start[k] + (p + r - rest_first[k]) * p
            share = x[rest[r]]
            for j in range(p):
                x[a + j] -= store[row + j] * share
        for i in range(p - 1, -1, -1):
            row = start[k] + i * p
            x[a + i] /= store[row + i]
            share = x[a + i]
            for j in range(i):
                x[a + j] -= store[row + j] * share


@final
@dataclass(frozen=True)
class _Elimination:
    """One front in numbers.

    Args:
        own: (p,) components eliminated.
        rest: (q,) components that take over.
        start: where A_pp (p, p) begins in the store; A_qp (q, p) follows it.
        parent: index of the front that takes over; -1 for none.
        place: (q,) rows of the rest in the parent's front.
    """

    own: IntArray
    rest: IntArray
    start: int
    parent: int
    place: IntArray


@final
@dataclass(frozen=True)
class _Order:
    """All fronts in the order of elimination, as `_substitute` wants them.

    Args:
        components: (size,) taken in this order.
        start: (fronts,) where each begins in the store.
        first: (fronts + 1,) where the components that each owns begin.
        rest_first: (fronts + 1,) where each begins in `rest`.
        rest: places, in this order, of the components that take over.
    """

    components: IntArray
    start: IntArray
    first: IntArray
    rest_first: IntArray
    rest: IntArray

    @classmethod
    def of(cls, fronts: list[_Elimination]) -> _Order:
        components = np.concatenate([front.own for front in fronts])
        place = np.empty(len(components), dtype=np.int64)
        place[components] = np.arange(len(components))
        return cls(
            components,
            np.array([front.start for front in fronts], dtype=np.int64),
            np.cumsum([0, *(len(front.own) for front in fronts)], dtype=np.int64),
            np.cumsum([0, *(len(front.rest) for front in fronts)], dtype=np.int64),
            place[np.concatenate([front.rest for front in fronts])],
        )


@final
class DissectedCholesky(LinearSolver):
    """Cholesky in the order of a nested dissection; refuses an indefinite matrix.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
        last: nodes that tie far places together.
    """

    def __init__(self, pattern: BlockPattern, free: Mask, last: IntArray | None = None) -> None:
        super().__init__(pattern, free)
        movable: Mask = np.asarray(self.free.any(axis=1))
        local = np.cumsum(movable) - 1
        kept = movable[pattern.row] & movable[pattern.column]
        rows, columns = local[pattern.row[kept]], local[pattern.column[kept]]
        size = len(self.free_nodes)
        graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size))
        far = np.zeros(0, np.int64) if last is None else local[last[movable[last]]]
        fronts = dissect((graph + graph.T).tocsr(), far)
        self._number = np.full(self.free.shape, -1, dtype=np.int64)
        self._number[self.free] = np.arange(self.size)
        self._dofs = np.flatnonzero(self.free.ravel())
        self._fronts, length = self._eliminations(fronts)
        self._order = _Order.of(self._fronts)
        self._place_entries()
        self._store = np.zeros(length)
        self._lent = False

    def _components(self, nodes: IntArray) -> IntArray:
        numbers = self._number[self.free_nodes[nodes]].ravel()
        return numbers[numbers >= 0]

    def _eliminations(self, fronts: tuple[Front, ...]) -> tuple[list[_Elimination], int]:
        whole = [self._components(np.concatenate([front.nodes, front.rest])) for front in fronts]
        place = np.empty(self.size, dtype=np.int64)
        found, start = [], 0
        for front, components in zip(fronts, whole, strict=True):
            p = len(self._components(front.nodes))
            rest = components[p:]
            if front.parent >= 0:
                place[whole[front.parent]] = np.arange(len(whole[front.parent]))
            found.append(_Elimination(components[:p], rest, start, front.parent, place[rest].copy()))
            start += p * len(components)
        return found, start

    def _place_entries(self) -> None:
        """Find where each entry of the matrix goes in the store."""
        row, column, self._source = lower_entries(self.pattern, self._number)
        owner, rank = np.empty(self.size, np.int64), np.empty(self.size, np.int64)
        for k, front in enumerate(self._fronts):
            owner[front.own], rank[front.own] = k, np.arange(len(front.own))
        order = owner * self.size + rank
        swap = order[row] < order[column]
        row, column = np.where(swap, column, row), np.where(swap, row, column)
        self._destination = np.empty(len(row), dtype=np.int64)
        self._diagonal = np.empty(self.size, dtype=np.int64)
        by_front = np.argsort(owner[column], kind="stable")
        bounds = np.searchsorted(owner[column][by_front], np.arange(len(self._fronts) + 1))
        place = np.empty(self.size, dtype=np.int64)
        for k, front in enumerate(self._fronts):
            p = len(front.own)
            mine = by_front[bounds[k] : bounds[k + 1]]
            place[front.own], place[front.rest] = np.arange(p), p + np.arange(len(front.rest))
            self._destination[mine] = front.start + place[row[mine]] * p + place[column[mine]]
            self._diagonal[front.own] = front.start + np.arange(p) * (p + 1)

    def _views(self, front: _Elimination) -> tuple[Array, Array]:
        """Return A_pp (p, p) and A_qp (q, p) of a front in the store."""
        p, middle = len(front.own), front.start + len(front.own) ** 2
        own = self._store[front.start : middle].reshape(p, p)
        return own, self._store[middle : middle + len(front.rest) * p].reshape(-1, p)

    def _factorise(self, blocks: Array, shift: float) -> bool:
        if self._lent:
            self._store, self._lent = np.empty_like(self._store), False
        scatter(blocks.reshape(-1), self._source, self._destination, self._diagonal, shift, self._store)
        waiting: list[list[tuple[IntArray, Array]]] = [[] for _ in self._fronts]
        for k, front in enumerate(self._fronts):
            own, below = self._views(front)
            left = np.zeros((len(front.rest),) * 2)
            for place, child in waiting[k]:
                _hand_on(own, below, left, place, child)
            waiting[k].clear()
            # a lower triangle stored by rows is an upper one stored by columns, as LAPACK wants it
            _, info = lapack.dpotrf(own.T, lower=0, clean=0, overwrite_a=1)
            if info != 0 or not own[-1, -1] > 0.0:
                return False
            if len(front.rest):
                blas.dtrsm(1.0, own.T, below.T, side=0, lower=0, trans_a=1, overwrite_b=1)
                blas.dsyrk(-1.0, below.T, beta=1.0, c=left.T, trans=1, lower=0, overwrite_c=1)
                waiting[front.parent].append((front.place, left))
        return True

    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        self._lent = True
        return (self._store,)

    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        (self._store,) = parts
        self._lent = True

    def _solve_sparse(self, loads: Array) -> Array:
        result, order = np.zeros((len(loads), 3 * self.pattern.nodes)), self._order
        dofs = self._dofs[order.components]
        for load, found in zip(loads.reshape(len(loads), -1), result, strict=True):
            x = load[dofs]
            _substitute(self._store, order.start, order.first, order.rest_first, order.rest, x)
            found[dofs] = x
        return result.reshape(len(loads), -1, 3)
