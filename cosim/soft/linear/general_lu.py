"""General LU factors: for tangents that are not symmetric, and to count negative pivots of those that are."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import InputError
from cosim.soft.linear.linear_solver import LinearSolver, equations, lower_entries, numbering
from cosim.soft.linear.low_rank import LowRank, negative_added
from cosim.soft.linear.pattern import BlockPattern


@final
class GeneralLU(LinearSolver):
    """SuperLU for tangents that are not symmetric; refuses a singular matrix, not an indefinite one.

    `extra` holds (nodes, (3 k, 3 k) matrix) parts added to the symmetric blocks before factorising.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        super().__init__(pattern, free)
        self._number = numbering(self.free, self.free_nodes)
        self._row, self._column, self._source = lower_entries(pattern, self._number)
        self._dofs = equations(self._number)
        self._factor: SuperLU | None = None
        self._factorised = csc_matrix((self.size, self.size))
        self.extra: list[tuple[IntArray, Array]] = []

    def matrix(self, blocks: Array, shift: float = 0.0) -> csc_matrix:
        """Return the whole matrix (size, size) of the free components."""
        value = blocks.reshape(-1)[self._source]
        lower = coo_matrix((value, (self._row, self._column)), shape=(self.size,) * 2)
        strict = self._row != self._column
        upper = coo_matrix((value[strict], (self._column[strict], self._row[strict])), shape=(self.size,) * 2)
        total = (lower + upper).tocsc()
        for nodes, part in self.extra:
            dofs = self._number[nodes].ravel()
            inside = dofs >= 0
            rows, columns = np.meshgrid(dofs[inside], dofs[inside], indexing="ij")
            value = part[np.ix_(inside, inside)].ravel()
            total = (
                total + coo_matrix((value, (rows.ravel(), columns.ravel())), shape=(self.size,) * 2).tocsc()
            )
        if shift:
            total = total + shift * coo_matrix((np.ones(self.size), (range(self.size),) * 2)).tocsc()
        return total.tocsc()

    def _factorise(self, blocks: Array, shift: float) -> bool:
        self._factorised = self.matrix(blocks, shift)
        try:
            self._factor = splu(self._factorised)
        except RuntimeError:  # SuperLU's word for a pivot that is exactly zero
            return False
        return True

    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        return self._factorised.data, self._factorised.indices, self._factorised.indptr

    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if self._factorised.data is not parts[0]:
            # SuperLU gives no factor out, but makes the same one of the same matrix
            try:
                matrix = csc_matrix(parts, shape=(self.size,) * 2)
                matrix.check_format(full_check=True)
                self._factorised, self._factor = matrix, splu(matrix)
            except (ValueError, TypeError, RuntimeError) as error:
                raise InputError(f"the saved factorisation is not one of this body: {error}") from error

    def _solve_sparse(self, loads: Array) -> Array:
        assert self._factor is not None, "factor() comes before solve()"
        count = len(loads)
        result = np.zeros((count, 3 * self.pattern.nodes))
        result[:, self._dofs] = self._factor.solve(loads.reshape(count, -1)[:, self._dofs].T).T
        return result.reshape(count, -1, 3)


def negative_pivots(pattern: BlockPattern, free: Mask, blocks: Array, low_rank: LowRank | None) -> int:
    """Return how many negative eigenvalues a symmetric matrix of the free components has.

    LU with a symmetric ordering and pivots from the diagonal gives L D L^T; the signs of D count (Sylvester's
    law of inertia), and dense terms by `negative_added`.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, components that move.
        blocks: (pattern.blocks, 3, 3) [N/m].
        low_rank: dense terms, or None.
    """
    solver = GeneralLU(pattern, free)
    solver._factor = factor = splu(
        solver.matrix(blocks), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )  # fmt: skip
    count = int((factor.U.diagonal() < 0.0).sum())
    return count if low_rank is None else count + negative_added(low_rank, solver._solve_sparse)
