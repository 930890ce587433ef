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
def _lower(factor, values, i, reach):  # type: ignore[no-untyped-def]
    """Solve row i of L for its value; `reach` rows before it are there."""
    row, before, value = factor[i], values[i - reach :], values[i]
    for k in range(reach):
        value -= row[reach - k] * before[k]
    return value * row[0]


@device_function
def _upper(factor, values, i, reach):  # type: ignore[no-untyped-def]
    """Solve row i of L^T for its value; `reach` rows after it are there."""
    rows, after, value = factor[i:], values[i:], values[i]
    for k in range(reach, 0, -1):
        value -= rows[k, k] * after[k]
    return value * rows[0, 0]


@device_function
def forward(factor, values):  # type: ignore[no-untyped-def]
    """Turn values (3 m,) into L^-1 values."""
    for i in range(BAND - 1):
        values[i] = _lower(factor, values, i, i)
    for i in range(BAND - 1, factor.shape[0]):  # as many steps in each row: what is known is unrolled
        values[i] = _lower(factor, values, i, BAND - 1)


@device_function
def backward(factor, values):  # type: ignore[no-untyped-def]
    """Turn values (3 m,) into L^-T values."""
    rows = factor.shape[0]
    for i in range(rows - 1, rows - BAND, -1):
        values[i] = _upper(factor, values, i, rows - 1 - i)
    for i in range(rows - BAND, -1, -1):
        values[i] = _upper(factor, values, i, BAND - 1)


@device_function
def forward_rows(factor, rows):  # type: ignore[no-untyped-def]
    """Turn the columns of rows (3 m, n) into L^-1 times them."""
    for i in range(factor.shape[0]):
        for k in range(max(0, i - BAND + 1), i):
            for c in range(rows.shape[1]):
                rows[i, c] -= factor[i, i - k] * rows[k, c]
        for c in range(rows.shape[1]):
            rows[i, c] *= factor[i, 0]
