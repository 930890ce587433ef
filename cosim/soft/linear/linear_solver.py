"""Direct solvers for the tangent stiffness of the free components, with one interface.

Envelope and fronts are two solvers for symmetric matrices, chosen by size (`cholesky.cholesky`); general LU
is for unsymmetric ones. Dense terms of low rank, A = S + W^T M W, are added by a correction of solutions and
never enter the sparse factor of S. With G = W S^-1 W^T and
N = (1 + M G)^-1 M the solution of A x = b is

    x = S^-1 (b - W^T N W S^-1 b)   (Sherman, Morrison and Woodbury).

Symmetric terms sum_k c_k v_k v_k^T are w_k = |c_k|^1/2 v_k with the signs s_k of c_k on the diagonal of M, so
that N is the inverse of H = diag(s) + G. Where S is positive definite, so is A if and only if H has as many
negative eigenvalues as c has negative entries (both count the inertia of one bordered matrix, by its two
Schur complements).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, final

import numpy as np
import scipy
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import InputError, SolverError
from cosim.soft.linear.pattern import BlockPattern

NODE, STORED, TILED, SOLVED = range(4)
"""Columns of the table of an `EnvelopeCholesky`."""


@final
@dataclass(frozen=True)
class LowRank:
    """The terms sum_k c_k v_k v_k^T.

    Args:
        vectors: (k, n, 3), v_k.
        coefficients: (k,), c_k.
    """

    vectors: Array
    coefficients: Array

    @classmethod
    def acting(cls, vectors: Array, coefficients: Array) -> LowRank | None:
        """Return the terms that are not zero, as copies; None if all are zero."""
        nonzero = np.flatnonzero(coefficients)
        return cls(vectors[nonzero], coefficients[nonzero]) if len(nonzero) else None

    def matrix(self) -> Array:
        """Return the sum as a dense matrix (3 n, 3 n)."""
        flat = self.vectors.reshape(len(self.coefficients), -1)
        return np.asarray(flat.T @ (self.coefficients[:, None] * flat))


@final
@dataclass(frozen=True)
class Tangent:
    """The tangent of a body: sparse symmetric blocks, dense terms, and unsymmetric terms of open caps.

    Args:
        pattern: of the blocks: that of the body, or a wider one with self-contact.
        blocks: (pattern.blocks, 3, 3) [N/m].
        low_rank: of sealed gas and commanded lengths; None for none.
        caps: unsymmetric terms of open caps: nodes (k,) of each ring, and (3 k, 3 k) [N/m].
    """

    pattern: BlockPattern
    blocks: Array
    low_rank: LowRank | None = None
    caps: Sequence[tuple[IntArray, Array]] = ()


@final
@dataclass(frozen=True)
class Correction:
    """Corrects solutions with S to solutions with A.

    Args:
        vectors: (k, 3 n), W.
        inner: (k, k), N.
    """

    vectors: Annotated[Array, ("k", "m")]
    inner: Annotated[Array, ("k", "k")]

    @classmethod
    def of(cls, terms: LowRank, product: Callable[[Array], Array]) -> Correction | None:
        """Return the correction by symmetric terms to a positive definite S; None if A is not.

        Args:
            terms: to add to S; not all zero.
            product: W (k, 3 n) -> W S^-1 W^T (k, k).
        """
        coefficients, vectors, inner = _bordered(terms, product)
        negative = (coefficients < 0.0).sum()
        if not np.isfinite(inner).all() or (np.linalg.eigvalsh(inner) <= 0.0).sum() != negative:
            return None
        return cls(vectors, np.asarray(np.linalg.inv(inner), np.float64))

    @classmethod
    def unsymmetric(
        cls, vectors: Array, middle: Array, product: Callable[[Array], Array]
    ) -> Correction | None:
        """Return the correction by W (k, 3 n) and M (k, k); None if A is singular."""
        try:
            inner = np.linalg.solve(np.eye(len(middle)) + middle @ product(vectors), middle)
        except np.linalg.LinAlgError:
            return None
        return cls(vectors, np.asarray(inner, np.float64)) if np.isfinite(inner).all() else None

    def load(self, solution: Array) -> Array:
        """Return W^T N W y (n, 3) of y = S^-1 b (n, 3)."""
        coefficients = self.inner @ (self.vectors @ solution.ravel())
        return np.asarray((coefficients @ self.vectors).reshape(solution.shape))


def negative_added(terms: LowRank, solve: Callable[[Array], Array]) -> int:
    """Return the number of negative eigenvalues of A minus that of S, which may be indefinite.

    The bordered matrix [[S, W], [W^T, -diag(s)]] has the Schur complements A (of the border) and -H (of S),
    so that n_-(A) + n_+(c) = n_-(S) + n_+(H). Source: Haynsworth, Linear Algebra Appl. 1 (1968) 73.

    Args:
        terms: to add to S.
        solve: loads (k, n, 3) -> S^-1 applied to each; S is regular.
    """
    if not terms.coefficients.any():
        return 0

    def product(vectors: Array) -> Array:
        return np.asarray(vectors @ solve(vectors.reshape(len(vectors), -1, 3)).reshape(len(vectors), -1).T)

    coefficients, _, inner = _bordered(terms, product)
    return int((np.linalg.eigvalsh(inner) > 0.0).sum()) - int((coefficients > 0.0).sum())


def _bordered(terms: LowRank, product: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
    """Return c (k,) without zeros, w (k, 3 n) and H (k, k)."""
    acting = terms.coefficients != 0.0
    coefficients = terms.coefficients[acting]
    scaled = np.sqrt(np.abs(coefficients))[:, None, None] * terms.vectors[acting]
    vectors = np.ascontiguousarray(scaled.reshape(len(coefficients), -1))
    inner = product(vectors)
    return coefficients, vectors, 0.5 * (inner + inner.T) + np.diag(np.sign(coefficients))


def by_component(mask: Mask) -> Mask:
    """Return a mask of nodes (n,) as one of components (n, 3); one of components unchanged."""
    return np.repeat(mask[:, None], 3, axis=1) if mask.ndim == 1 else mask


@final
@dataclass(frozen=True)
class FactorState:
    """A factorisation, for `LinearSolver.state`; its arrays are read-only from then on.

    Args:
        parts: arrays of the sparse factor, specific to the solver.
        correction: by the dense terms; None without any.
    """

    parts: tuple[Annotated[NDArray[Any], ("*",)], ...]
    correction: Correction | None


class LinearSolver(ABC):
    """Factorises A = K + shift 1 + sum_k c_k v_k v_k^T of the free components and solves with it.

    The dense terms never enter the sparse factor of K + shift 1; see `Correction`. `groups` are the free
    nodes in the order of a nested dissection; None until it is computed. `extra` are unsymmetric terms;
    solvers of symmetric matrices ignore them.

    Args:
        pattern: of the whole body.
        free: (n,) bool, nodes that can move, or (n, 3) bool, world components that can.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        self.pattern = pattern
        self.free: Mask = by_component(free)
        self.free_nodes: IntArray = np.flatnonzero(self.free.any(axis=1))
        self.size = int(self.free.sum())
        self.groups: list[IntArray] | None = None
        self.extra: Sequence[tuple[IntArray, Array]] = ()
        self._correction: Correction | None = None

    def factor(self, blocks: Array, shift: float = 0.0, low_rank: LowRank | None = None) -> bool:
        """Factorise; return False if the matrix is not positive definite (symmetric solvers) or singular.

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
    def multiplications(self) -> float:
        """Approximate number of multiplications of a factorisation."""
        return float(self.pattern.blocks)

    @property
    def correction(self) -> Correction | None:
        """Correction by the dense terms; None without any."""
        return self._correction

    @property
    def apart(self) -> IntArray:
        """First node of each uncoupled part, and the number of nodes (k + 1,)."""
        return np.array([0, self.pattern.nodes])

    def solve(self, load: Array, turn: Array | None = None) -> Array:
        """Return the displacement (n, 3) [m] under a load (n, 3) [N]; zero where clamped.

        Args:
            load: on all nodes.
            turn: (3, 3), rotation of the body, and its matrix, since the factorisation; None for none.
        """
        if self._correction is None:
            return self._solve_turned(load, turn)
        turned = load if turn is None else load @ turn
        solution = np.asarray(self.solve_all(turned[None])[0])
        return solution if turn is None else solution @ turn.T

    def solve_all(self, loads: Array) -> Array:
        """Return the displacements (k, n, 3) [m] under k loads (k, n, 3) [N]; zero where clamped."""
        solutions = np.ascontiguousarray(self._solve_sparse(loads))
        if self._correction is not None:
            corrections = np.array([self._correction.load(solution) for solution in solutions])
            solutions = np.ascontiguousarray(self._solve_sparse(loads - corrections))
        return solutions

    @property
    def state(self) -> FactorState:
        """The factorisation; that of a solver with the same pattern and free components can be set."""
        return FactorState(self._export_factor(), self._correction)

    @state.setter
    def state(self, state: FactorState) -> None:
        correction = state.correction
        if correction is not None and correction.vectors.shape[1] != 3 * self.pattern.nodes:
            raise InputError("the saved correction of a factorisation is of another body")
        self._correction = correction
        self._import_factor(state.parts)

    def _product(self, vectors: Array) -> Array:
        """Return W S^-1 W^T (k, k) of W (k, 3 n), S the sparse part."""
        loads = vectors.reshape(len(vectors), -1, 3)
        return np.asarray(vectors @ self._solve_sparse(loads).reshape(len(vectors), -1).T)

    def _solve_turned(self, load: Array, turn: Array | None) -> Array:
        """Return the solution without dense terms, see `solve`."""
        if turn is None:
            return np.asarray(self._solve_sparse(load[None])[0])
        return np.asarray(self._solve_sparse((load @ turn)[None])[0] @ turn.T)

    @abstractmethod
    def _export_factor(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays of the sparse factor; they are read-only from now on."""

    @abstractmethod
    def _import_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        """Set the sparse factor to read-only arrays of `_export_factor`."""

    @abstractmethod
    def _factorise(self, blocks: Array, shift: float) -> bool:
        """Factorise the sparse part; return False if it is not positive definite, or singular."""

    @abstractmethod
    def _solve_sparse(self, loads: Array) -> Array:
        """Return the displacements (k, n, 3) [m] of the sparse part under loads (k, n, 3) [N]."""


def numbering(free: Mask, order: IntArray) -> IntArray:
    """Return the equation (n, 3) of each component, -1 if clamped, for nodes in `order`."""
    number = np.full(free.shape, -1, dtype=np.int64)
    nodes, components = np.nonzero(free[order])
    number[order[nodes], components] = np.arange(len(nodes))
    return number


def equations(number: IntArray) -> IntArray:
    """Return the component 3 node + axis (size,) of each equation."""
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
    # diagonal blocks hold both triangles of a symmetric block: only the lower one is used
    twice = (pattern.row == pattern.column)[:, None] & (r < c)
    used = (row >= 0) & (column >= 0) & ~twice
    index = np.flatnonzero(used)
    row, column = row[used], column[used]
    return np.maximum(row, column), np.minimum(row, column), index


_GROWTH = 6.0


@final
class ShiftSearch:
    """Searches the smallest shift mu_k = mu_0 6^k that makes a matrix positive definite.

    A matrix that is definite with a shift is so with any larger one, so the result does not depend on where
    the search starts. Starting next to the last result takes two or three factorisations, instead of one for
    each smaller shift.
    """

    def __init__(self) -> None:
        self._power = 0

    def factor(self, definite: Callable[[float], bool], start: float, most: float) -> int:
        """Factorise with the smallest shift that works, or none; return the attempts, negative if none works.

        Args:
            definite: shift -> whether the matrix is positive definite; its last call leaves the factor.
            start: mu_0, larger than 0.
            most: largest shift.
        """
        attempts = 0

        def works(power: int) -> bool:
            nonlocal attempts
            attempts += 1
            return definite(start * _GROWTH**power)

        if definite(0.0):
            return 1
        power = max(0, self._power - 1)
        if works(power):
            while power > 0 and works(power - 1):
                power -= 1
            if power > 0:  # the last attempt failed
                works(power)
        else:
            while not works(power := power + 1):
                if start * _GROWTH ** (power + 1) > most:
                    return -1 - attempts
        self._power = power
        return 1 + attempts


# half the time of SuperLU's defaults, which are for any matrix
_NEARLY_SYMMETRIC: Final[dict[str, Any]] = {
    "permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.1, "options": {"SymmetricMode": True},
}  # fmt: skip


@final
class GeneralLU(LinearSolver):
    """SuperLU for unsymmetric tangents; fails for singular matrices, not for indefinite ones.

    `extra` holds (nodes, (3 k, 3 k) matrix) terms, added to the symmetric blocks before factorising.
    """

    def __init__(self, pattern: BlockPattern, free: Mask) -> None:
        super().__init__(pattern, free)
        self._number = numbering(self.free, self.free_nodes)
        self._row, self._column, self._source = lower_entries(pattern, self._number)
        self._dofs = equations(self._number)
        self._factor: scipy.sparse.linalg.SuperLU | None = None
        self._factorised = scipy.sparse.csc_matrix((self.size, self.size))

    def matrix(self, blocks: Array, shift: float = 0.0) -> scipy.sparse.csc_matrix:
        """Return the whole matrix (size, size) of the free components."""
        value, shape = blocks.reshape(-1)[self._source], (self.size,) * 2
        coo_matrix = scipy.sparse.coo_matrix
        lower = coo_matrix((value, (self._row, self._column)), shape=shape)
        strict = self._row != self._column
        upper = coo_matrix((value[strict], (self._column[strict], self._row[strict])), shape=shape)
        total = (lower + upper).tocsc()
        for nodes, terms in self.extra:
            dofs = self._number[nodes].ravel()
            inside = dofs >= 0
            rows, columns = np.meshgrid(dofs[inside], dofs[inside], indexing="ij")
            value = terms[np.ix_(inside, inside)].ravel()
            total = total + coo_matrix((value, (rows.ravel(), columns.ravel())), shape=shape).tocsc()
        if shift:
            total = total + shift * coo_matrix((np.ones(self.size), (range(self.size),) * 2)).tocsc()
        return total.tocsc()

    def _factorise(self, blocks: Array, shift: float) -> bool:
        self._factorised = self.matrix(blocks, shift)
        try:
            self._factor = scipy.sparse.linalg.splu(self._factorised, **_NEARLY_SYMMETRIC)
        except RuntimeError:  # raised by SuperLU for a pivot of exactly zero
            return False
        return True

    def _export_factor(self) -> tuple[NDArray[Any], ...]:
        return self._factorised.data, self._factorised.indices, self._factorised.indptr

    def _import_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        if self._factorised.data is not parts[0]:
            # SuperLU does not export its factor, but the same matrix gives the same one
            try:
                matrix = scipy.sparse.csc_matrix(parts, shape=(self.size,) * 2)
                matrix.check_format(full_check=True)
                self._factorised, self._factor = matrix, scipy.sparse.linalg.splu(matrix, **_NEARLY_SYMMETRIC)
            except (ValueError, TypeError, RuntimeError) as error:
                raise InputError(f"the saved factorisation is not one of this body: {error}") from error

    def _solve_sparse(self, loads: Array) -> Array:
        assert self._factor is not None, "factor() comes before solve()"
        count = len(loads)
        solutions = np.zeros((count, 3 * self.pattern.nodes))
        solutions[:, self._dofs] = self._factor.solve(loads.reshape(count, -1)[:, self._dofs].T).T
        return solutions.reshape(count, -1, 3)


def negative_pivots(pattern: BlockPattern, free: Mask, blocks: Array, low_rank: LowRank | None) -> int:
    """Return the number of negative eigenvalues of a symmetric matrix of the free components.

    LU with a symmetric ordering and pivots from the diagonal gives L D L^T; the signs of D give the number
    (Sylvester's law of inertia); dense terms are added by `negative_added`.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, components that move.
        blocks: (pattern.blocks, 3, 3) [N/m].
        low_rank: dense terms, or None.

    Raises:
        SolverError: the matrix is singular.
    """
    solver = GeneralLU(pattern, free)
    try:
        solver._factor = factor = scipy.sparse.linalg.splu(
            solver.matrix(blocks), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )  # fmt: skip
    except RuntimeError as error:
        raise SolverError(
            "nothing resists some motion of the film, which is slack: start at a pressure, or set film.law "
            "to 'wrinkling'"
        ) from error
    count = int((factor.U.diagonal() < 0.0).sum())
    return count if low_rank is None else count + negative_added(low_rank, solver._solve_sparse)
