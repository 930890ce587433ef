"""Dense terms of low rank beside a sparse matrix: A = S + W^T M W.

They never enter the sparse factor of S. With G = W S^-1 W^T and N = (1 + M G)^-1 M the solution of A x = b is

    x = S^-1 (b - W^T N W S^-1 b)   (Sherman, Morrison and Woodbury).

Symmetric terms sum_k c_k v_k v_k^T are w_k = |c_k|^1/2 v_k with the signs s_k of c_k on the diagonal of M, so
that N is the inverse of H = diag(s) + G. Where S is positive definite, so is A if and only if H has as many
negative eigenvalues as c has negative entries (both count the inertia of one bordered matrix, by its two
Schur complements).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

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
        """Return the correction by symmetric terms; None where A is not positive definite, if S is.

        Args:
            terms: to add to S; not all zero.
            product: returns W S^-1 W^T (k, k) of W (k, 3 n).
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
        """Return the correction by W (k, 3 n) and M (k, k); None where A is singular."""
        try:
            found = np.linalg.solve(np.eye(len(middle)) + middle @ product(vectors), middle)
        except np.linalg.LinAlgError:
            return None
        return cls(vectors, np.asarray(found, np.float64)) if np.isfinite(found).all() else None

    def load(self, solution: Array) -> Array:
        """Return W^T N W y (n, 3) of y = S^-1 b (n, 3)."""
        share = self.inner @ (self.vectors @ solution.ravel())
        return np.asarray((share @ self.vectors).reshape(solution.shape))


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
