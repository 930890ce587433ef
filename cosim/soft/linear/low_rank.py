"""Dense terms of low rank beside a sparse matrix: A = S + sum_k c_k v_k v_k^T.

They never enter the sparse factor of S. With w_k = |c_k|^1/2 v_k, the signs s_k of c_k, Z = S^-1 W and
H = diag(s) + W^T Z the solution of A x = b is

    x = y - Z H^-1 W^T y,   y = S^-1 b   (Sherman, Morrison and Woodbury).

Where S is positive definite, so is A if and only if H has as many negative eigenvalues as c has negative
entries (both count the inertia of one bordered matrix, by its two Schur complements).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from cosim.base.frames import Array


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
        """Return those of some terms that are not zero, as copies; None where all are."""
        there = np.flatnonzero(coefficients)
        return cls(vectors[there], coefficients[there]) if len(there) else None

    def matrix(self) -> Array:
        """Return the sum as a dense matrix (3 n, 3 n)."""
        flat = self.vectors.reshape(len(self.coefficients), -1)
        return np.asarray(flat.T @ (self.coefficients[:, None] * flat))


@final
@dataclass(frozen=True)
class LowRankCorrection:
    """Corrects solutions with S to solutions with A.

    Args:
        vectors: (k, 3 n), w_k.
        answers: (k, 3 n), S^-1 w_k.
        inner: LU factor of H and its pivots; None where A is not positive definite.
    """

    vectors: Annotated[Array, ("k", "m")]
    answers: Annotated[Array, ("k", "m")]
    inner: tuple[Annotated[Array, ("k", "k")], Annotated[NDArray[np.int32], ("k",)]] | None

    @classmethod
    def of(cls, terms: LowRank, solve: Callable[[Array], Array]) -> LowRankCorrection:
        """Return the correction by some terms.

        Args:
            terms: to add to S; not all zero.
            solve: returns S^-1 applied to each of (k, n, 3) loads.
        """
        coefficients, vectors, answers, inner = _bordered(terms, solve)
        definite = bool(np.isfinite(inner).all()) and bool(
            (np.linalg.eigvalsh(inner) <= 0.0).sum() == (coefficients < 0.0).sum()
        )
        if not definite:
            return cls(vectors, answers, None)
        factor, pivots = lu_factor(inner, check_finite=False)
        return cls(vectors, answers, (np.ascontiguousarray(factor), pivots))

    @property
    def definite(self) -> bool:
        """Whether A is positive definite, if S is."""
        return self.inner is not None

    def apply(self, solution: Array) -> None:
        """Turn y = S^-1 b (n, 3) into A^-1 b, in place."""
        assert self.inner is not None, "only a definite sum is solved with"
        share = lu_solve(self.inner, self.vectors @ solution.ravel(), check_finite=False)
        solution -= (share @ self.answers).reshape(solution.shape)


def negative_added(terms: LowRank, solve: Callable[[Array], Array]) -> int:
    """Return how many negative eigenvalues A has more than S, which need not be definite; mostly below 0.

    The bordered matrix [[S, W], [W^T, -diag(s)]] has the Schur complements A (of the border) and -H (of S),
    so that n_-(A) + n_+(c) = n_-(S) + n_+(H). Source: Haynsworth, Linear Algebra Appl. 1 (1968) 73.

    Args:
        terms: to add to S.
        solve: returns S^-1 applied to each of (k, n, 3) loads; S is regular.
    """
    if not terms.coefficients.any():
        return 0
    coefficients, _, _, inner = _bordered(terms, solve)
    return int((np.linalg.eigvalsh(inner) > 0.0).sum()) - int((coefficients > 0.0).sum())


def _bordered(terms: LowRank, solve: Callable[[Array], Array]) -> tuple[Array, Array, Array, Array]:
    """Return c (k,) without zeros, w (k, 3 n), S^-1 w (k, 3 n) and H (k, k)."""
    acting = terms.coefficients != 0.0
    coefficients = terms.coefficients[acting]
    scaled = np.sqrt(np.abs(coefficients))[:, None, None] * terms.vectors[acting]
    answers = solve(scaled).reshape(len(coefficients), -1)
    vectors = scaled.reshape(len(coefficients), -1)
    inner = vectors @ answers.T
    return coefficients, vectors, answers, 0.5 * (inner + inner.T) + np.diag(np.sign(coefficients))
