"""Cholesky factorisation within the envelope of the matrix, for long bodies, or by fronts, for wide ones.

Uncoupled bodies are factorised one by one. In the envelope, row i of L is stored from the first entry of row
i of A; there is no fill before it. Rows and columns are grouped by four, as tiles:
    L_IJ = (A_IJ - sum_K L_IK L_JK^T) L_JJ^-T,   L_II L_II^T = A_II - sum_K L_IK L_IK^T.
Front k eliminates its components p and passes the rest q to its parent:
    A_pp = L L^T,   W = A_qp L^-T,   U = A_qq - W W^T.
L^-1 is stored instead of L: fronts are narrow, and products with it are fast.
Sources: George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 4;
Duff and Reid, ACM Trans. Math. Software 9 (1983) 302 (the multifrontal method).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, NamedTuple, final

import numpy as np
import scipy
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray, Mask, PlaceArray
from cosim.base.state_checks import KnownStates, check_state
from cosim.soft.linear import envelope_kernels, fronts, linear_solver
from cosim.soft.linear.dissection import dissect
from cosim.soft.linear.envelope_kernels import (
    SingleFactor,
    TileEntries,
    TileFactor,
    TileLists,
    factorise,
    forward,
)
from cosim.soft.linear.fronts import COLUMNS, FrontLists, FrontRoom, FrontTree
from cosim.soft.linear.pattern import BlockPattern, part_of, uncoupled_ranges

_TILE: Final = 4
_STRAIGHT = np.eye(3)
# Mean width of an envelope above which fronts are faster. At 137 entries a row fronts take 1.2 times as long
# as the envelope, at 287 half as long; a solution takes 1.2 and 0.7 times as long.
_WIDEST_ENVELOPE = 200
_FRONT_NODES = 12  # nodes eliminated together


def _first_entries(row: IntArray, column: IntArray, size: int) -> IntArray:
    """Return the column (size,) of the first entry in each row of the lower triangle."""
    first = np.arange(size)
    np.minimum.at(first, row, column)
    return first


def _best_order(pattern: BlockPattern, movable: Mask, like: IntArray | None) -> IntArray:
    """Return the movable nodes in the order of least work: as numbered, Cuthill-McKee, or their reverses.

    If `like` is the best order of a pattern with fewer couplings, only that and its reverse are compared.
    """
    nodes = np.flatnonzero(movable)
    if not len(nodes):
        return nodes
    local = np.cumsum(movable) - 1
    used = movable[pattern.row] & movable[pattern.column]
    rows, columns = local[pattern.row[used]], local[pattern.column[used]]
    as_numbered = np.arange(len(nodes))
    if like is None:
        graph = scipy.sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(nodes),) * 2)
        levels = np.asarray(
            scipy.sparse.csgraph.reverse_cuthill_mckee((graph + graph.T).tocsr(), True), dtype=np.int64
        )
        orders = [as_numbered, as_numbered[::-1], levels, levels[::-1]]
    else:
        orders = [local[like], local[like][::-1]]

    def work(order: IntArray) -> int:
        rank = np.argsort(order)
        a, b = rank[rows], rank[columns]
        width = as_numbered - _first_entries(np.maximum(a, b), np.minimum(a, b), len(nodes))
        return int((width**2).sum())

    return np.asarray(nodes[min(orders, key=work)])


@final
@dataclass(frozen=True)
class _Part:
    """The envelope of a range of nodes without coupling to others.

    Args:
        entries: of A, see `factorise`, with sources in the blocks of the whole body.
        start: start of each tile row in the store.
        first: first tile of each tile row.
        dofs: (size,), component 3 node + axis of each equation, nodes numbered from the range's first.
        stored: number of entries of L.
        bandwidth: of A.
    """

    entries: TileEntries
    start: PlaceArray
    first: PlaceArray
    dofs: IntArray
    stored: int
    bandwidth: int

    @classmethod
    def of(cls, pattern: BlockPattern, free: Mask, nodes: tuple[int, int], like: IntArray | None) -> _Part:
        """Return the envelope of a range of nodes.

        Args:
            pattern: of the whole body.
            free: (n, 3) bool, components that can move.
            nodes: first node, and the one after the last.
            like: elimination order of the whole body for a pattern with fewer couplings, or None.
        """
        begin, end = nodes
        part_pattern, first_block = part_of(pattern, begin, end)
        movable, room = free[begin:end], 9 * part_pattern.blocks
        order = None if like is None else like[(begin <= like) & (like < end)] - begin
        number = linear_solver.numbering(
            movable, _best_order(part_pattern, np.asarray(movable.any(axis=1)), order)
        )
        dofs = linear_solver.equations(number)
        tiles = -(-len(dofs) // _TILE)
        lists = TileLists(*(np.empty(size, np.uint64) for size in (tiles + 1, tiles, tiles + 1, room, room)))
        bandwidth = envelope_kernels.list_entries(
            part_pattern.row, part_pattern.column, number, first_block, lists
        )
        count = int(lists.entry[-1])
        entries = TileEntries(lists.source[:count].copy(), lists.place[:count].copy(), lists.entry)
        return cls(entries, lists.start[:-1].copy(), lists.first, dofs, int(lists.start[-1]), bandwidth)


class PartFactor(NamedTuple):
    """L of a range of nodes without coupling to others.

    Args:
        factor: its tiles, in either precision.
        dofs: (size,), component of each equation, of the range's nodes.
        nodes: the range.
    """

    factor: TileFactor | SingleFactor
    dofs: IntArray
    nodes: slice

    def rounded(self) -> PartFactor:
        """Return the same in single precision."""
        start, first, *numbers = self.factor
        store, inverse = (values.astype(np.float32) for values in numbers)
        return self._replace(factor=SingleFactor(start, first, store, inverse))


@final
class EnvelopeCholesky(linear_solver.LinearSolver):
    """Cholesky factorisation within the envelope; fails for an indefinite matrix.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
        like: solver of the same components with fewer couplings, whose elimination order is reused.
    """

    def __init__(self, pattern: BlockPattern, free: Mask, like: EnvelopeCholesky | None = None) -> None:
        super().__init__(pattern, free)
        range_starts, order = uncoupled_ranges(pattern), None if like is None else like.order
        parts = [_Part.of(pattern, self.free, nodes, order) for nodes in pairwise(range_starts.tolist())]
        self._parts = parts
        sizes = [(part.stored, len(part.start), len(part.dofs)) for part in parts]
        ends = np.cumsum([(0, 0, 0), *sizes], axis=0, dtype=np.int64)
        self._table = np.column_stack([range_starts, ends])
        self._factors: tuple[Array, list[PartFactor]] | None = None
        self._rounded: list[PartFactor] = []
        self.bandwidth = max(part.bandwidth for part in parts)
        self._store, self._inverse = np.empty(ends[-1, 0]), np.empty(_TILE * ends[-1, 1])
        self._lent = False  # whether a saved state uses the arrays of the factor
        self._known = KnownStates()

    @cached_property
    def order(self) -> IntArray:
        """Movable nodes in the order of elimination, part by part."""
        nodes_by_part = []
        for part, begin in zip(self._parts, self.apart[:-1].tolist(), strict=True):
            nodes, first = np.unique(part.dofs // 3, return_index=True)
            nodes_by_part.append(begin + nodes[np.argsort(first)])
        return np.concatenate(nodes_by_part)

    @property
    def mean_width(self) -> float:
        """Mean number of entries in a row of L."""
        return len(self._store) / max(self.size, 1)

    @property
    def multiplications(self) -> float:
        return self.size * self.mean_width**2

    @property
    def apart(self) -> IntArray:
        return np.ascontiguousarray(self._table[:, linear_solver.NODE])

    @property
    def factors(self) -> list[PartFactor]:
        """L of each part, for `substitute`."""
        if self._factors is None or self._factors[0] is not self._store:
            cuts = self._table[:, linear_solver.NODE].tolist()
            self._factors = (
                self._store,
                [
                    PartFactor(self._factor_of(k), part.dofs, slice(*cuts[k : k + 2]))
                    for k, part in enumerate(self._parts)
                ],
            )
        return self._factors[1]

    @property
    def rounded(self) -> list[PartFactor]:
        """L of each part in single precision, for `substitute_singly`; made once per factorisation."""
        if not self._rounded:
            self._rounded = [part.rounded() for part in self.factors]
        return self._rounded

    @property
    def pivots(self) -> Array:
        """Pivots (size,): squares of the diagonal of L, part by part."""
        return np.asarray(1.0 / self._inverse[self._diagonal] ** 2)

    @cached_property
    def _diagonal(self) -> IntArray:
        tiled = self._table[:-1, linear_solver.TILED].tolist()
        starts_and_parts = zip(tiled, self._parts, strict=True)
        return np.concatenate([_TILE * begin + np.arange(len(part.dofs)) for begin, part in starts_and_parts])

    def _factor_of(self, number: int) -> TileFactor:
        """Return L of a part."""
        (_, stored, tiled, _), (_, stored_end, tiled_end, _) = self._table[number : number + 2]
        store, inverse = self._store[stored:stored_end], self._inverse[_TILE * tiled : _TILE * tiled_end]
        return TileFactor(self._parts[number].start, self._parts[number].first, store, inverse)

    def _factorise(self, blocks: Array, shift: float) -> bool:
        self._rounded = []
        if self._lent:
            self._store, self._inverse = np.empty_like(self._store), np.empty_like(self._inverse)
            self._lent = False
        return all(
            factorise(blocks.reshape(-1), part.entries, shift, len(part.dofs), self._factor_of(number))
            for number, part in enumerate(self._parts)
        )

    def _export_factor(self) -> tuple[NDArray[Any], ...]:
        self._lent = True
        self._known.add(self._store)
        return self._store, self._inverse

    def _import_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if parts[0] not in self._known or parts[1].shape != self._inverse.shape:
            check_state(parts, (self._store, self._inverse), place="state.soft.newton.factor.parts")
        self._store, self._inverse = parts
        self._rounded = []
        self._lent = True
        self._known.add(self._store)

    def _solve_sparse(self, loads: Array) -> Array:
        return self._substituted(loads, _STRAIGHT)

    def _product(self, vectors: Array) -> Array:
        loads, total = vectors.reshape(len(vectors), -1, 3), np.zeros((len(vectors), len(vectors)))
        for number, part in enumerate(self._parts):
            begin, end = self._table[number : number + 2, linear_solver.NODE]
            part_loads = np.ascontiguousarray(loads[:, begin:end]).reshape(len(loads), -1)
            forward_solutions = np.zeros((len(loads), _TILE * len(part.start)))
            forward(self._factor_of(number), part.dofs, part_loads, forward_solutions)
            total += forward_solutions @ forward_solutions.T
        return total

    def _solve_turned(self, load: Array, turn: Array | None) -> Array:
        return np.asarray(self._substituted(load[None], _STRAIGHT if turn is None else turn)[0])

    def _substituted(self, loads: Array, turn: Array) -> Array:
        solutions = []
        for number, part in enumerate(self._parts):
            begin, end = self._table[number : number + 2, linear_solver.NODE]
            part_loads = np.array(loads[:, begin:end], order="C")
            if len(self._parts) == 1 or part_loads.any():
                envelope_kernels.substitute(self._factor_of(number), part.dofs, turn, part_loads)
            solutions.append(part_loads)
        return solutions[0] if len(solutions) == 1 else np.concatenate(solutions, axis=1)


def cholesky(
    pattern: BlockPattern, free: Mask, far: IntArray, like: linear_solver.LinearSolver | None = None
) -> linear_solver.LinearSolver:
    """Return the faster solver for a symmetric matrix: envelope or fronts.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, world components that can move.
        far: nodes that are coupled across the mesh.
        like: solver of the same components with fewer couplings, whose elimination order is reused.
    """
    if not isinstance(like, DissectedCholesky):
        envelope = EnvelopeCholesky(pattern, free, like if isinstance(like, EnvelopeCholesky) else None)
        if envelope.mean_width <= _WIDEST_ENVELOPE:
            return envelope
    if like is not None and like.groups is None:
        like.groups = _dissected(like, far)
    return DissectedCholesky(pattern, free, far, None if like is None else like.groups)


def _graph(solver: linear_solver.LinearSolver) -> scipy.sparse.csr_matrix:
    """Return the adjacency of a solver's free nodes."""
    pattern, movable = solver.pattern, np.asarray(solver.free.any(axis=1))
    local = np.cumsum(movable) - 1
    used = movable[pattern.row] & movable[pattern.column] & (pattern.row != pattern.column)
    rows, columns = local[pattern.row[used]], local[pattern.column[used]]
    half = scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(solver.free_nodes),) * 2)
    return (half + half.T).tocsr()


def _dissected(solver: linear_solver.LinearSolver, far: IntArray | None) -> list[IntArray]:
    """Return a solver's free nodes in the order of a nested dissection, in groups."""
    movable = np.asarray(solver.free.any(axis=1))
    local = np.cumsum(movable) - 1
    tied = np.zeros(0, np.int64) if far is None else local[far[movable[far]]]
    return dissect(_graph(solver), tied, _FRONT_NODES)


@final
class DissectedCholesky(linear_solver.LinearSolver):
    """Cholesky factorisation in the order of a nested dissection; fails for an indefinite matrix.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
        far: nodes that are coupled across the mesh.
        groups: of free nodes in the order of elimination; None to compute them.
    """

    def __init__(
        self,
        pattern: BlockPattern,
        free: Mask,
        far: IntArray | None = None,
        groups: list[IntArray] | None = None,
    ) -> None:
        super().__init__(pattern, free)
        self.groups = groups = _dissected(self, far) if groups is None else groups
        number = linear_solver.numbering(self.free, self.free_nodes[np.concatenate(groups)])
        self._dofs = linear_solver.equations(number)
        self._tree = FrontTree.of(_graph(self), groups, number[self.free_nodes])
        self._place_entries(number)
        tree, front_sizes = self._tree, np.diff(self._tree.first)
        rest_sizes = np.diff(tree.rest_first)
        widest = int(front_sizes.max())
        length = int((front_sizes * (front_sizes + rest_sizes)).max())
        self._work, self._spare = np.empty(length), np.empty(length + 2 * widest)
        self._own_values, self._rest_values = np.empty(widest), np.empty(max(widest, COLUMNS))
        self._stack = np.empty(tree.stack)
        self._store = np.empty(int(tree.start[-1]))
        self._multiplications = float((front_sizes * (front_sizes + rest_sizes) ** 2).sum())
        self._lent = False
        self._known = KnownStates()

    @property
    def multiplications(self) -> float:
        return self._multiplications

    def _place_entries(self, number: IntArray) -> None:
        """Compute the index of each entry of the matrix in the store, front by front."""
        tree = self._tree
        row, column, source = linear_solver.lower_entries(self.pattern, number)
        front, place_in_front = tree.place(row, column)
        order = np.argsort(tree.start[front] + place_in_front)
        self._source, self._place = (array[order].astype(np.uint64) for array in (source, place_in_front))
        entry_first = np.searchsorted(front[order], np.arange(len(tree.first)))
        starts = (tree.first, tree.start, tree.rest_first, tree.child_first, tree.run_first, entry_first)
        table = np.stack([*starts, np.append(tree.left, 0)], axis=1)
        lists = (array.astype(np.uint64) for array in (table, tree.children, tree.runs, tree.rows))
        self._lists, self._rest = FrontLists(*lists), tree.rest.astype(np.uint64)

    def _factorise(self, blocks: Array, shift: float) -> bool:
        if self._lent:
            self._store, self._lent = np.empty_like(self._store), False
        room = FrontRoom(self._work, self._spare, self._stack, self._store)
        return bool(fronts.factorise(blocks.reshape(-1), self._source, self._place, shift, self._lists, room))

    def _export_factor(self) -> tuple[NDArray[Any], ...]:
        self._lent = True
        self._known.add(self._store)
        return (self._store,)

    def _import_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if parts[0] not in self._known:
            check_state(parts, (self._store,), place="state.soft.newton.factor.parts")
        (self._store,) = parts
        self._lent = True
        self._known.add(self._store)

    def _solve_sparse(self, loads: Array) -> Array:
        solutions = np.zeros((len(loads), 3 * self.pattern.nodes))
        for load, solution in zip(loads.reshape(len(loads), -1), solutions, strict=True):
            x = load[self._dofs]
            fronts.substitute(
                self._store, self._lists.fronts, self._rest, self._own_values, self._rest_values, x
            )
            solution[self._dofs] = x
        return solutions.reshape(len(loads), -1, 3)
