"""Cholesky within the envelope of the matrix: for long bodies, whose numbering follows their length.

Row i of L is kept from the first entry of row i of A on; no fill lies before it. Rows and columns are taken
four at a time, as tiles:
    L_IJ = (A_IJ - sum_K L_IK L_JK^T) L_JJ^-T,   L_II L_II^T = A_II - sum_K L_IK L_IK^T.
Source: George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 4.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from cosim.base.frames import Array, IntArray, Mask, PlaceArray
from cosim.base.state_check import KnownStates, check_state
from cosim.soft.linear.envelope_kernels import factorise, substitute
from cosim.soft.linear.linear_solver import LinearSolver, equations, lower_entries, numbering
from cosim.soft.linear.pattern import BlockPattern

_TILE = 4
_STRAIGHT = np.eye(3)


def _first_entries(row: IntArray, column: IntArray, size: int) -> IntArray:
    """Return the first column (size,) of every row of the lower triangle with such entries."""
    first = np.arange(size)
    np.minimum.at(first, row, column)
    return first


def _best_order(pattern: BlockPattern, movable: Mask) -> IntArray:
    """Return the movable nodes in the order of least work: as numbered, backwards, or Cuthill-McKee's."""
    nodes = np.flatnonzero(movable)
    local = np.cumsum(movable) - 1
    kept = movable[pattern.row] & movable[pattern.column]
    rows, columns = local[pattern.row[kept]], local[pattern.column[kept]]
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(nodes),) * 2)
    levels = np.asarray(reverse_cuthill_mckee((graph + graph.T).tocsr(), True), dtype=np.int64)
    as_numbered = np.arange(len(nodes))

    def work(order: IntArray) -> int:
        rank = np.argsort(order)
        a, b = rank[rows], rank[columns]
        width = as_numbered - _first_entries(np.maximum(a, b), np.minimum(a, b), len(nodes))
        return int((width**2).sum())

    return np.asarray(nodes[min((as_numbered, as_numbered[::-1], levels, levels[::-1]), key=work)])


@final
class EnvelopeCholesky(LinearSolver):
    """Cholesky within the envelope; refuses an indefinite matrix.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        super().__init__(pattern, free)
        number = numbering(self.free, _best_order(pattern, np.asarray(self.free.any(axis=1))))
        row, column, source = lower_entries(pattern, number)
        self.bandwidth = int((row - column).max(initial=0))
        self._dofs = equations(number)
        tiles = -(-self.size // _TILE)
        first = _first_entries(row // _TILE, column // _TILE, tiles)
        wide = _TILE * (np.arange(tiles) - first + 1)
        ends = np.cumsum(_TILE * wide)
        start = ends - _TILE * wide

        def place(row: IntArray, column: IntArray) -> IntArray:
            tile = row // _TILE
            at = start[tile] + row % _TILE * wide[tile] + column - _TILE * first[tile]
            return np.asarray(at)

        order = np.argsort(row // _TILE, kind="stable")  # nearly in order as it is
        entry = np.searchsorted(row[order] // _TILE, np.arange(tiles + 1))
        parts = source[order], place(row, column)[order], entry
        self._entries = tuple(part.astype(np.uint64) for part in parts)
        self._places = start.astype(np.uint64), first.astype(np.uint64)
        self._store, self._inverse = np.empty(int(wide.sum()) * _TILE), np.empty(_TILE * tiles)
        self._lent = False  # whether a saved state holds the factor
        self._known = KnownStates()

    @property
    def mean_width(self) -> float:
        """Entries of a row of L on average."""
        return len(self._store) / max(self.size, 1)

    @property
    def envelope(self) -> tuple[Array, PlaceArray, PlaceArray, Array, IntArray] | None:
        """What `substitute` takes of the factor, in order; None where dense terms go beside it."""
        start, first = self._places
        return None if self._correction else (self._store, start, first, self._inverse, self._dofs)

    def _factorise(self, blocks: Array, shift: float) -> bool:
        if self._lent:
            self._store, self._inverse = np.empty_like(self._store), np.empty_like(self._inverse)
            self._lent = False
        source, place, entry = self._entries
        values, start_first = blocks.reshape(-1), self._places
        return bool(
            factorise(
                values, source, place, entry, shift, self.size, *start_first, self._store, self._inverse
            )
        )

    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        self._lent = True
        self._known.add(self._store)
        return self._store, self._inverse

    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if parts[0] not in self._known:
            check_state(parts, (self._store, self._inverse), place="state.soft.newton.factor.parts")
        self._store, self._inverse = parts
        self._lent = True
        self._known.add(self._store)

    def _solve_sparse(self, loads: Array) -> Array:
        result = np.array(loads, order="C")
        substitute(self._store, *self._places, self._inverse, self._dofs, _STRAIGHT, result)
        return result

    def _solve_turned(self, load: Array, turn: Array | None) -> Array:
        result = np.array(load[None], order="C")
        straight = _STRAIGHT if turn is None else turn
        substitute(self._store, *self._places, self._inverse, self._dofs, straight, result)
        return np.asarray(result[0])
