"""Cholesky factor of a closed ring's matrix: each node is coupled with itself and its two neighbours.

Taken from both sides at once, as 0, 1, m - 1, 2, m - 2, ..., neighbours are two places apart at most, so
that the closed ring becomes a band: with three unknowns a node, row i reaches back to column i - 8.
A band (3 m, 9) holds entry (i, j), i - 8 <= j <= i, at [i, i - j]; of a factor, the diagonal is reciprocal.
"""

from __future__ import annotations

import math
from typing import Final

from cosim.base.kernels import device_function

BAND: Final = 9


@device_function
def place_in_band(node, count):  # type: ignore[no-untyped-def]
    """Return the place of a node of a ring of so many."""
    if node == 0:
        return 0
    return 2 * node - 1 if 2 * node <= count else 2 * (count - node)


@device_function
def factorise(band, shift, factor):  # type: ignore[no-untyped-def]
    """Fill factor with L, L L^T = band + shift 1; return whether that is positive definite."""
    for i in range(band.shape[0]):
        for j in range(max(0, i - BAND + 1), i + 1):
            value = band[i, i - j]
            for k in range(max(0, i - BAND + 1), j):
                value -= factor[i, i - k] * factor[j, j - k]
            if i > j:
                factor[i, i - j] = value * factor[j, 0]
            else:
                value += shift
                if not value > 0.0:
                    return False
                factor[i, 0] = 1.0 / math.sqrt(value)
    return True


@device_function
def forward(factor, values):  # type: ignore[no-untyped-def]
    """Turn values (3 m,) into L^-1 values."""
    for i in range(factor.shape[0]):
        for k in range(max(0, i - BAND + 1), i):
            values[i] -= factor[i, i - k] * values[k]
        values[i] *= factor[i, 0]


@device_function
def backward(factor, values):  # type: ignore[no-untyped-def]
    """Turn values (3 m,) into L^-T values."""
    for i in range(factor.shape[0] - 1, -1, -1):
        values[i] *= factor[i, 0]
        for k in range(max(0, i - BAND + 1), i):
            values[k] -= factor[i, i - k] * values[i]


@device_function
def forward_rows(factor, rows):  # type: ignore[no-untyped-def]
    """Turn the columns of rows (3 m, n) into L^-1 times them."""
    for i in range(factor.shape[0]):
        for k in range(max(0, i - BAND + 1), i):
            for c in range(rows.shape[1]):
                rows[i, c] -= factor[i, i - k] * rows[k, c]
        for c in range(rows.shape[1]):
            rows[i, c] *= factor[i, 0]
