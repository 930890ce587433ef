"""Cholesky factors of the block-tridiagonal tangents of chains.

With free frames f and the blocks A_f on the diagonal and B_f before them:
    L_f L_f^T = A_f + shift diag(scale) - S_f S_f^T,    S_f = B_f L_(f-1)^-T.
The diagonals of the L_f are kept as their reciprocals.
"""

from __future__ import annotations

import numpy as np

from cosim.base.kernels import device_function


@device_function
def _cholesky(low, f):  # type: ignore[no-untyped-def]
    """Factorise the lower triangle of block f in place; False where it is not positive definite."""
    for j in range(6):
        for i in range(j, 6):
            total = low[f, i, j]
            for k in range(j):
                total -= low[f, i, k] * low[f, j, k]
            low[f, i, j] = total
        if not low[f, j, j] > 0.0:
            return False
        inverse = 1.0 / np.sqrt(low[f, j, j])
        low[f, j, j] = inverse
        for i in range(j + 1, 6):
            low[f, i, j] *= inverse
    return True


@device_function
def factorise(free, diagonal, off, shift, scale, low, side):  # type: ignore[no-untyped-def]
    """Fill low and side (f, 6, 6) with L and S; False where the free part is not positive definite."""
    for f in range(free.shape[0]):
        if not free[f]:
            continue
        for i in range(6):
            for k in range(i + 1):
                low[f, i, k] = diagonal[f, i, k]
            low[f, i, i] += shift * scale[i]
        if f > 0 and free[f - 1]:
            for i in range(6):
                for k in range(6):
                    total = off[f, i, k]
                    for j in range(k):
                        total -= side[f, i, j] * low[f - 1, k, j]
                    side[f, i, k] = total * low[f - 1, k, k]
            for i in range(6):
                for k in range(i + 1):
                    total = low[f, i, k]
                    for j in range(6):
                        total -= side[f, i, j] * side[f, k, j]
                    low[f, i, k] = total
        if not _cholesky(low, f):
            return False
    return True


@device_function
def substitute(free, low, side, load, step):  # type: ignore[no-untyped-def]
    """Solve with the factor for load (f, 6); step (f, 6) is zero where a frame is held."""
    count = free.shape[0]
    for f in range(count):
        for i in range(6):
            if not free[f]:
                step[f, i] = 0.0
                continue
            total = load[f, i]
            if f > 0 and free[f - 1]:
                for j in range(6):
                    total -= side[f, i, j] * step[f - 1, j]
            for j in range(i):
                total -= low[f, i, j] * step[f, j]
            step[f, i] = total * low[f, i, i]
    for f in range(count - 1, -1, -1):
        if not free[f]:
            continue
        for i in range(5, -1, -1):
            total = step[f, i]
            if f + 1 < count and free[f + 1]:
                for j in range(6):
                    total -= side[f + 1, j, i] * step[f + 1, j]
            for j in range(i + 1, 6):
                total -= low[f, j, i] * step[f, j]
            step[f, i] = total * low[f, i, i]
