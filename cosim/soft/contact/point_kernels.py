"""Kernels of contact points and of the extent of a body."""

from __future__ import annotations

import numpy as np
from numba import void

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDEX_TABLE, INDICES, MATRIX, VECTOR, kernel


@kernel(void(MATRIX, INDEX_TABLE, MATRIX, INDICES, MATRIX))
def combine(x: Array, nodes: IntArray, weights: Array, chosen: IntArray, out: Array) -> None:
    """Fill out[k] = sum_a weights[k, a] x[nodes[k, a]] for chosen k."""
    for k in chosen:
        for r in range(3):
            out[k, r] = (
                weights[k, 0] * x[nodes[k, 0], r]
                + weights[k, 1] * x[nodes[k, 1], r]
                + weights[k, 2] * x[nodes[k, 2], r]
            )


@kernel(void(MATRIX, MATRIX, VECTOR, VECTOR, VECTOR))
def span(x: Array, v: Array, low: Array, high: Array, fastest: Array) -> None:
    """Fill smallest and largest coordinates of x and, in fastest[0], the largest |v| squared."""
    low[:], high[:], fastest[0] = np.inf, -np.inf, 0.0
    for n in range(x.shape[0]):
        square = 0.0
        for r in range(3):
            low[r] = min(low[r], x[n, r])
            high[r] = max(high[r], x[n, r])
            square += v[n, r] * v[n, r]
        fastest[0] = max(fastest[0], square)
