"""The tangent of a body with open ends: that of the closed one, and a small term that is not symmetric.

With K the closed body's tangent, held by springs D at the rings that caps would close, S the free components
of these and E what the missing caps add there, less D,

    (K + S E S^T) x = b:   x = y - Z u,   (1 + E G) u = E S^T y,   y = K^-1 b,   Z = K^-1 S,   G = S^T Z.

Source: Woodbury's formula, Golub and Van Loan, Matrix Computations, section 2.1.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.state_check import check_indices
from cosim.errors import InputError
from cosim.soft.linear.linear_solver import LinearSolver
from cosim.soft.linear.multifrontal_cholesky import cholesky
from cosim.soft.linear.pattern import BlockPattern
from cosim.soft.published.general_lu import GeneralLU


@final
@dataclass(frozen=True)
class MissingCaps:
    """What missing caps change in solutions.

    Args:
        components: (r,), 3 node + axis of the rows of S^T.
        stiffness: (r, r) [N/m], E.
        answers: (r, 3 n) [m/N], Z^T.
        inner: LU factor of 1 + E G and its pivots.
    """

    components: IntArray
    stiffness: Array
    answers: Array
    inner: tuple[Array, NDArray[np.int32]]

    @classmethod
    def of(cls, components: IntArray, stiffness: Array, answers: Array) -> MissingCaps:
        """Return the change, with its small matrix factorised."""
        inner = np.eye(len(components)) + stiffness @ answers[:, components].T
        return cls(components, stiffness, answers, lu_factor(inner, check_finite=False))

    def apply(self, solution: Array) -> None:
        """Turn y (3 n,) into x, in place."""
        pull = lu_solve(self.inner, self.stiffness @ solution[self.components], check_finite=False)
        solution -= pull @ self.answers


@final
class OpenCapSolver(LinearSolver):
    """Cholesky of the closed body's tangent with a term of low rank beside it, general LU where it has none.

    As general LU it refuses a singular matrix, not an indefinite one. `extra` holds (nodes, (3 k, 3 k)
    matrix) parts added to the symmetric blocks before factorising.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, world components that can move.
        far: nodes that are tied together across the mesh.
        like: solver of the same components with fewer ties, whose order of elimination is taken over.
    """

    def __init__(
        self, pattern: BlockPattern, free: Mask, far: IntArray, like: LinearSolver | None = None
    ) -> None:
        super().__init__(pattern, free)
        closed: LinearSolver | None = like._closed if isinstance(like, OpenCapSolver) else None
        self._closed: LinearSolver = cholesky(pattern, self.free, far, closed)
        self._diagonal = np.flatnonzero(pattern.row == pattern.column)  # node by node
        self._general: GeneralLU | None = None  # made when it is needed
        self._caps: MissingCaps | None = None
        self.extra: list[tuple[IntArray, Array]] = []

    def _factorise(self, blocks: Array, shift: float) -> bool:
        self._caps = self._caps_of(blocks, shift)
        if self._caps is not None:
            return True
        self._general = self._general or GeneralLU(self.pattern, self.free)
        self._general.extra = self.extra
        return self._general.factor(blocks, shift)

    def _caps_of(self, blocks: Array, shift: float) -> MissingCaps | None:
        """Factorise K; return what goes beside it, None where K is indefinite.

        Without the springs, under pressure and without the pull of its caps, the closed body would buckle
        like a column.
        """
        rings = [np.zeros(0, np.int64), *(ring for ring, _ in self.extra)]
        nodes = np.unique(np.concatenate(rings))
        slots = self._diagonal[nodes]
        held, axes = blocks.copy(), np.arange(3)
        springs = np.abs(blocks[slots][:, axes, axes])
        held[slots[:, None], axes, axes] += springs
        if not self._closed.factor(held, shift):
            return None
        components, stiffness = _components(nodes), -np.diag(springs.ravel())
        for ring, part in self.extra:
            own = np.searchsorted(components, _components(ring))
            stiffness[np.ix_(own, own)] += part
        inside = self.free.ravel()[components]
        components, stiffness = components[inside], stiffness[np.ix_(inside, inside)]
        loads = np.zeros((len(components), 3 * self.pattern.nodes))
        loads[np.arange(len(components)), components] = 1.0
        answers = self._closed._solve_sparse(loads.reshape(len(loads), -1, 3)).reshape(loads.shape)
        found = MissingCaps.of(components, stiffness, answers)
        return found if np.isfinite(found.inner[0]).all() and found.inner[0].diagonal().all() else None

    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        caps = self._caps
        if caps is None:
            assert self._general is not None, "factor() comes before save_state()"
            return self._general._lend_factor()
        return (caps.components, caps.stiffness, caps.answers, *self._closed._lend_factor())

    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if len(parts) == _GENERAL:
            self._general, self._caps = self._general or GeneralLU(self.pattern, self.free), None
            self._general._take_factor(parts)
            return
        components, stiffness, answers = parts[:3]
        count = len(components)
        check_indices(components, 3 * self.pattern.nodes, "components")
        if stiffness.shape != (count, count) or answers.shape != (count, 3 * self.pattern.nodes):
            raise InputError("the saved factorisation is of another body with open ends")
        self._closed._take_factor(parts[3:])
        self._caps = MissingCaps.of(components, stiffness, answers)

    def _solve_sparse(self, loads: Array) -> Array:
        caps = self._caps
        if caps is None:
            assert self._general is not None, "factor() comes before solve()"
            return self._general._solve_sparse(loads)
        solutions = self._closed._solve_sparse(loads)
        for solution in solutions.reshape(len(loads), -1):
            caps.apply(solution)
        return solutions


_GENERAL = 3  # parts of a general factor; with Cholesky there are four or more


def _components(ring: IntArray) -> IntArray:
    return np.ravel(3 * ring[:, None] + np.arange(3))
