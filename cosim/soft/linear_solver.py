"""Direct solvers for the tangent stiffness of the free nodes, behind one small interface."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import final

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import SuperLU, splu

from cosim.frames import Array, IntArray, Mask
from cosim.soft.kernels import INDICES, REAL, VECTOR, kernel
from cosim.soft.pattern import BlockPattern


@kernel((VECTOR, INDICES, INDICES, INDICES, REAL, VECTOR))
def _scatter(values, source, destination, diagonal, shift, band):  # type: ignore[no-untyped-def]
    """Write values[source] to band[destination] and add shift to its diagonal; zero elsewhere."""
    band[:] = 0.0
    for k in range(source.shape[0]):
        band[destination[k]] = values[source[k]]
    if shift != 0.0:
        for k in range(diagonal.shape[0]):
            band[diagonal[k]] += shift


class LinearSolver(ABC):
    """Factorises K + shift 1 of the free nodes and solves with it.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        self.pattern = pattern
        self.free_nodes: IntArray = np.flatnonzero(free)
        self.size = 3 * len(self.free_nodes)

    @abstractmethod
    def factor(self, blocks: Array, shift: float = 0.0) -> bool:
        """Factorise; False when the matrix is not positive definite (where the method can tell).

        Args:
            blocks: (pattern.blocks, 3, 3) [N/m].
            shift: added to the diagonal [N/m].
        """

    @abstractmethod
    def solve(self, load: Array) -> Array:
        """Return the displacement (n, 3) [m] under a load (n, 3) [N]; zero at clamped nodes."""


def _lower_entries(pattern: BlockPattern, rank: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return (row, column, index into blocks.ravel()) of the lower triangle in the order `rank`.

    Args:
        pattern: of the whole body.
        rank: (n,) position of each node, negative where clamped.
    """
    kept = np.flatnonzero((rank[pattern.row] >= 0) & (rank[pattern.column] >= 0))
    r, c = (axis.ravel() for axis in np.meshgrid(np.arange(3), np.arange(3), indexing="ij"))
    row = (3 * rank[pattern.row[kept]][:, None] + r).ravel()
    column = (3 * rank[pattern.column[kept]][:, None] + c).ravel()
    index = (9 * kept[:, None] + 3 * r + c).ravel()
    # diagonal blocks hold both triangles of a symmetric block: keep the lower one only
    same = np.repeat(pattern.row[kept] == pattern.column[kept], 9)
    keep = ~(same & (row < column))
    row, column, index = row[keep], column[keep], index[keep]
    return np.maximum(row, column), np.minimum(row, column), index


@final
class BandedCholesky(LinearSolver):
    """LAPACK's banded Cholesky in reverse Cuthill-McKee order; refuses an indefinite matrix."""

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        super().__init__(pattern, free)
        kept = free[pattern.row] & free[pattern.column]
        local = np.full(pattern.nodes, -1, dtype=np.int64)
        local[self.free_nodes] = np.arange(len(self.free_nodes))
        rows, columns = local[pattern.row[kept]], local[pattern.column[kept]]
        graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(self.free_nodes),) * 2)
        orders = [np.arange(len(self.free_nodes)), reverse_cuthill_mckee((graph + graph.T).tocsr(), True)]
        ranks = [np.argsort(order) for order in orders]
        best = min(ranks, key=lambda rank: int(np.abs(rank[rows] - rank[columns]).max(initial=0)))
        rank = np.full(pattern.nodes, -1, dtype=np.int64)
        rank[self.free_nodes] = best
        row, column, self._source = _lower_entries(pattern, rank)
        self.bandwidth = int((row - column).max(initial=0))
        self._destination = (row - column) + column * (self.bandwidth + 1)
        self._diagonal = np.arange(self.size) * (self.bandwidth + 1)
        self._band = np.zeros(self.size * (self.bandwidth + 1))
        self._dofs = (3 * self.free_nodes[np.argsort(best)][:, None] + np.arange(3)).ravel()
        self._factor: Array = np.zeros((0, 0))

    def factor(self, blocks: Array, shift: float = 0.0) -> bool:
        _scatter(blocks.reshape(-1), self._source, self._destination, self._diagonal, shift, self._band)
        matrix = self._band.reshape(self.size, self.bandwidth + 1).T
        self._factor, info = lapack.dpbtrf(matrix, lower=1, overwrite_ab=1)
        return bool(info == 0)

    def solve(self, load: Array) -> Array:
        solution, _ = lapack.dpbtrs(self._factor, load.reshape(-1)[self._dofs], lower=1, overwrite_b=1)
        result = np.zeros(3 * self.pattern.nodes)
        result[self._dofs] = solution
        return result.reshape(-1, 3)


@final
class GeneralLU(LinearSolver):
    """SuperLU for tangents that are not symmetric; cannot tell whether the matrix is definite.

    `extra` holds (nodes, (3 k, 3 k) matrix) parts added to the symmetric blocks before factorising.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        super().__init__(pattern, free)
        self._rank = np.full(pattern.nodes, -1, dtype=np.int64)
        self._rank[self.free_nodes] = np.arange(len(self.free_nodes))
        self._row, self._column, self._source = _lower_entries(pattern, self._rank)
        self._dofs = (3 * self.free_nodes[:, None] + np.arange(3)).ravel()
        self._factor: SuperLU | None = None
        self.extra: list[tuple[IntArray, Array]] = []

    def matrix(self, blocks: Array, shift: float = 0.0) -> csc_matrix:
        """Return the whole matrix (size, size) of the free nodes."""
        value = blocks.reshape(-1)[self._source]
        lower = coo_matrix((value, (self._row, self._column)), shape=(self.size,) * 2)
        strict = self._row != self._column
        upper = coo_matrix((value[strict], (self._column[strict], self._row[strict])), shape=(self.size,) * 2)
        total = (lower + upper).tocsc()
        for nodes, part in self.extra:
            dofs = (3 * self._rank[nodes][:, None] + np.arange(3)).ravel()
            inside = np.repeat(self._rank[nodes] >= 0, 3)
            rows, columns = np.meshgrid(dofs[inside], dofs[inside], indexing="ij")
            value = part[np.ix_(inside, inside)].ravel()
            total = (
                total + coo_matrix((value, (rows.ravel(), columns.ravel())), shape=(self.size,) * 2).tocsc()
            )
        if shift:
            total = total + shift * coo_matrix((np.ones(self.size), (range(self.size),) * 2)).tocsc()
        return total.tocsc()

    def factor(self, blocks: Array, shift: float = 0.0) -> bool:
        self._factor = splu(self.matrix(blocks, shift))
        return True

    def solve(self, load: Array) -> Array:
        assert self._factor is not None, "factor() comes before solve()"
        result = np.zeros(3 * self.pattern.nodes)
        result[self._dofs] = self._factor.solve(load.reshape(-1)[self._dofs])
        return result.reshape(-1, 3)
