"""Direct solvers for the tangent stiffness of the free components, behind one small interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray, Mask, PlaceArray
from cosim.errors import InputError
from cosim.soft.linear.low_rank import Correction, LowRank
from cosim.soft.linear.pattern import BlockPattern


def by_component(mask: Mask) -> Mask:
    """Return a mask of nodes (n,) as one of components (n, 3); one of components as it is."""
    return np.repeat(mask[:, None], 3, axis=1) if mask.ndim == 1 else mask


class EnvelopeArrays(NamedTuple):
    """A factor as `substitute` takes it, part after part.

    Args:
        store: entries of L.
        start: where each tile's rows begin in its part's entries.
        first: first tile of each, of its part.
        inverse: reciprocal diagonal.
        dofs: component of each equation, of its part's nodes.
        parts: (parts + 1, 4), where the nodes, entries, tiles and equations of each begin.
    """

    store: Array
    start: PlaceArray
    first: PlaceArray
    inverse: Array
    dofs: IntArray
    parts: IntArray


@final
@dataclass(frozen=True)
class FactorState:
    """A factorisation, for `LinearSolver.restore_state`; its arrays are not written to again.

    Args:
        parts: of the sparse factor, as the kind of solver has them.
        correction: by the dense terms; None without any.
    """

    parts: tuple[Annotated[NDArray[Any], ("*",)], ...]
    correction: Correction | None


class LinearSolver(ABC):
    """Factorises A = K + shift 1 + sum_k c_k v_k v_k^T of the free components and solves with it.

    The dense terms never enter the sparse factor of K + shift 1; see `low_rank`.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        self.pattern = pattern
        self.free: Mask = by_component(free)
        self.free_nodes: IntArray = np.flatnonzero(self.free.any(axis=1))
        self.size = int(self.free.sum())
        self._correction: Correction | None = None

    def factor(self, blocks: Array, shift: float = 0.0, low_rank: LowRank | None = None) -> bool:
        """Factorise; False when the matrix is not positive definite (where the method can tell).

        Args:
            blocks: (pattern.blocks, 3, 3) [N/m].
            shift: added to the diagonal [N/m].
            low_rank: dense terms, or None.
        """
        self._correction = None
        if not self._factorise(blocks, shift):
            return False
        if low_rank is not None and low_rank.coefficients.any():
            self._correction = Correction.of(low_rank, self._product)
            return self._correction is not None
        return True

    @property
    def correction(self) -> Correction | None:
        """By the dense terms; None without any."""
        return self._correction

    @property
    def envelope(self) -> EnvelopeArrays | None:
        """The sparse factor, where it is one that kernels know."""
        return None

    @property
    def apart(self) -> IntArray:
        """Where the nodes of each part begin that can be factorised by itself, and their number (k + 1,)."""
        return np.array([0, self.pattern.nodes])

    def factor_part(self, number: int, blocks: Array, shift: float = 0.0) -> bool:
        """Factorise one part, without dense terms; the others stay as they are.

        Args:
            number: of the part, in the order of `apart`.
            blocks: (pattern.blocks, 3, 3) [N/m]; those of the part count.
            shift: added to the diagonal [N/m].
        """
        return self.factor(blocks, shift)

    def solve(self, load: Array, turn: Array | None = None) -> Array:
        """Return the displacement (n, 3) [m] under a load (n, 3) [N]; zero where clamped.

        Args:
            load: on all nodes.
            turn: (3, 3), rotation of the body since it was factorised, its matrix with it; None for none.
        """
        if self._correction is None:
            return self._solve_turned(load, turn)
        own = load if turn is None else load @ turn
        solution = np.asarray(self.solve_all(own[None])[0])
        return solution if turn is None else solution @ turn.T

    def solve_all(self, loads: Array) -> Array:
        """Return the displacements (k, n, 3) [m] under k loads (k, n, 3) [N]; zero where clamped."""
        solutions = np.ascontiguousarray(self._solve_sparse(loads))
        if self._correction is not None:
            answered = np.array([self._correction.load(solution) for solution in solutions])
            solutions = np.ascontiguousarray(self._solve_sparse(loads - answered))
        return solutions

    def save_state(self) -> FactorState:
        """Return the factorisation in store."""
        return FactorState(self._lend_factor(), self._correction)

    def restore_state(self, state: FactorState) -> None:
        """Take a factorisation of `save_state`, of a solver with the same pattern and free components."""
        correction = state.correction
        if correction is not None and correction.vectors.shape[1] != 3 * self.pattern.nodes:
            raise InputError("the saved correction of a factorisation is of another body")
        self._correction = correction
        self._take_factor(state.parts)

    def _product(self, vectors: Array) -> Array:
        """Return W S^-1 W^T (k, k) of W (k, 3 n), S the sparse part."""
        loads = vectors.reshape(len(vectors), -1, 3)
        return np.asarray(vectors @ self._solve_sparse(loads).reshape(len(vectors), -1).T)

    def _solve_turned(self, load: Array, turn: Array | None) -> Array:
        """Return what `solve` does without dense terms."""
        if turn is None:
            return np.asarray(self._solve_sparse(load[None])[0])
        return np.asarray(self._solve_sparse((load @ turn)[None])[0] @ turn.T)

    @abstractmethod
    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays of the sparse factor; they are not written to from now on."""

    @abstractmethod
    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        """Take the sparse factor from arrays of `_lend_factor`, which are not written to."""

    @abstractmethod
    def _factorise(self, blocks: Array, shift: float) -> bool:
        """Factorise the sparse part; False when it is not positive definite (where the method can tell)."""

    @abstractmethod
    def _solve_sparse(self, loads: Array) -> Array:
        """Return the displacements (k, n, 3) [m] of the sparse part under loads (k, n, 3) [N]."""


def numbering(free: Mask, order: IntArray) -> IntArray:
    """Return the equation (n, 3) of each component, -1 where clamped, with the nodes taken in `order`."""
    number = np.full(free.shape, -1, dtype=np.int64)
    nodes, components = np.nonzero(free[order])
    number[order[nodes], components] = np.arange(len(nodes))
    return number


def equations(number: IntArray) -> IntArray:
    """Return the component 3 node + axis (size,) that each equation stands for."""
    components = np.flatnonzero(number.ravel() >= 0)
    return np.asarray(components[np.argsort(number.ravel()[components])])


def lower_entries(pattern: BlockPattern, number: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return (row, column, index into blocks.ravel()) of the lower triangle.

    Args:
        pattern: of the whole body.
        number: (n, 3) equation of each component, -1 where clamped.
    """
    r, c = (axis.ravel() for axis in np.meshgrid(np.arange(3), np.arange(3), indexing="ij"))
    row = number[pattern.row][:, r]
    column = number[pattern.column][:, c]
    # diagonal blocks hold both triangles of a symmetric block: keep the lower one only
    twice = (pattern.row == pattern.column)[:, None] & (r < c)
    kept = (row >= 0) & (column >= 0) & ~twice
    index = np.flatnonzero(kept)
    row, column = row[kept], column[kept]
    return np.maximum(row, column), np.minimum(row, column), index
