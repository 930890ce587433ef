"""Kernels of Cholesky's method within the envelope, on tiles of four rows and four columns."""

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Places, Singles, Vector
from cosim.base.kernels import allocating, device_function, kernel

# Places are unsigned in the kernels: an index that might be negative would be wrapped, and keep loops scalar.
_1, _2, _3, _4 = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)

_Four: TypeAlias = tuple[float, float, float, float]
_Sums: TypeAlias = tuple[_Four, _Four, _Four, _Four]


class TileEntries(NamedTuple):
    """Entries of A.

    Args:
        source: their indices in the flat blocks.
        place: their indices in the store.
        first: (tiles + 1,), first entry of each tile.
    """

    source: Places
    place: Places
    first: Places


class TileFactor(NamedTuple):
    """L: rows 4 I to 4 I + 3 begin in column 4 first[I], at start[I] in the store, one after the other.

    Args:
        start: (tiles,).
        first: (tiles,).
        store: entries.
        inverse: reciprocal diagonal.
    """

    start: Places
    first: Places
    store: Vector
    inverse: Vector


class SingleFactor(NamedTuple):
    """L in single precision, see `TileFactor`: a solution's time is that of reading its bytes.

    Args:
        start: (tiles,).
        first: (tiles,).
        store: entries.
        inverse: reciprocal diagonal.
    """

    start: Places
    first: Places
    store: Singles
    inverse: Singles


class TileLists(NamedTuple):
    """Indices of a matrix' entries, tile by tile.

    Args:
        entry: (tiles + 1,), first entry of each tile, and the number of entries.
        first: (tiles,), first tile of each tile row.
        start: (tiles + 1,), start of each tile row in the store, and the end of the last one.
        source: of each entry, its index in the flat blocks; allocated for 9 per block.
        place: of each entry, its index in the store; allocated likewise.
    """

    entry: Places
    first: Places
    start: Places
    source: Places
    place: Places


@device_function
def _equations(number: IndexTable, row: int, column: int, k: int) -> tuple[int, int]:
    """Return row and column of entry k of a block in the lower triangle, -1 if it is not used."""
    r, c = k // 3, k % 3
    i, j = number[row, r], number[column, c]
    # diagonal blocks hold both triangles of a symmetric block: only the lower one is used
    if i < 0 or j < 0 or (row == column and r < c):
        return -1, -1
    return max(i, j), min(i, j)


@kernel
def list_entries(row: Indices, column: Indices, number: IndexTable, before: int, lists: TileLists) -> int:
    """Fill the indices of the lower triangle's entries; return the bandwidth.

    Args:
        row: (blocks,) node of each block's rows.
        column: (blocks,) of its columns, none beyond the row.
        number: (n, 3), equation of each component, -1 where it is clamped.
        before: blocks of other parts that come first.
        lists: filled.
    """
    entry, first, start, widest, tiles = lists.entry, lists.first, lists.start, 0, lists.first.shape[0]
    entry[:], start[0] = 0, 0
    for t in range(tiles):
        first[t] = t
    for s in range(row.shape[0]):
        for k in range(9):
            i, j = _equations(number, row[s], column[s], k)
            if i >= 0:
                entry[i // 4 + 1] += _1
                first[i // 4], widest = min(first[i // 4], np.uint64(j // 4)), max(widest, i - j)
    for t in range(tiles):
        entry[t + 1] += entry[t]
        start[t + 1] = start[t] + _4 * _4 * (np.uint64(t) - first[t] + _1)
    for s in range(row.shape[0]):
        for k in range(9):
            i, j = _equations(number, row[s], column[s], k)
            if i >= 0:
                tile, at = i // 4, entry[i // 4]
                wide = 4 * (tile - np.int64(first[tile]) + 1)
                lists.source[at] = 9 * (before + s) + k
                lists.place[at] = np.int64(start[tile]) + i % 4 * wide + j - 4 * np.int64(first[tile])
                entry[tile] += _1
    for t in range(tiles, 0, -1):  # from where each ends to where it begins
        entry[t] = entry[t - 1]
    entry[0] = 0
    return widest


@device_function
def _products(store: Vector, a: Any, wide_a: Any, b: Any, wide_b: Any, count: Any) -> _Sums:
    """Return the sums of products of four rows at a and four at b, over `count` columns."""
    s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = 0.0
    s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = 0.0
    at1, at2, at3 = a + wide_a, a + _2 * wide_a, a + _3 * wide_a
    to1, to2, to3 = b + wide_b, b + _2 * wide_b, b + _3 * wide_b
    for k in range(count):
        a0, a1, a2, a3 = store[a + k], store[at1 + k], store[at2 + k], store[at3 + k]
        b0, b1, b2, b3 = store[b + k], store[to1 + k], store[to2 + k], store[to3 + k]
        s00 += a0 * b0
        s01 += a0 * b1
        s02 += a0 * b2
        s03 += a0 * b3
        s10 += a1 * b0
        s11 += a1 * b1
        s12 += a1 * b2
        s13 += a1 * b3
        s20 += a2 * b0
        s21 += a2 * b1
        s22 += a2 * b2
        s23 += a2 * b3
        s30 += a3 * b0
        s31 += a3 * b1
        s32 += a3 * b2
        s33 += a3 * b3
    return (s00, s01, s02, s03), (s10, s11, s12, s13), (s20, s21, s22, s23), (s30, s31, s32, s33)


@device_function
def _finish_row(
    store: Vector, at: Any, sums: _Four, below: tuple[float, float, float, float, float, float], scale: _Four
) -> None:
    """Turn a row of A_IJ into that of L_IJ, given L_JJ's strict lower triangle and inverse diagonal."""
    l10, l20, l21, l30, l31, l32 = below
    x0 = (store[at] - sums[0]) * scale[0]
    x1 = (store[at + _1] - sums[1] - x0 * l10) * scale[1]
    x2 = (store[at + _2] - sums[2] - x0 * l20 - x1 * l21) * scale[2]
    x3 = (store[at + _3] - sums[3] - x0 * l30 - x1 * l31 - x2 * l32) * scale[3]
    store[at], store[at + _1], store[at + _2], store[at + _3] = x0, x1, x2, x3


@device_function
def _finish_diagonal(store: Vector, at: Any, wide: Any, inverse: Vector, c: Any, sums: _Sums) -> bool:
    """Turn A_II into L_II, given the sums of products; False where it is not positive definite."""
    at1, at2, at3 = at + wide, at + _2 * wide, at + _3 * wide
    p0 = store[at] - sums[0][0]
    v0 = 1.0 / math.sqrt(p0)
    l10 = (store[at1] - sums[1][0]) * v0
    p1 = store[at1 + _1] - sums[1][1] - l10 * l10
    v1 = 1.0 / math.sqrt(p1)
    l20 = (store[at2] - sums[2][0]) * v0
    l21 = (store[at2 + _1] - sums[2][1] - l20 * l10) * v1
    p2 = store[at2 + _2] - sums[2][2] - l20 * l20 - l21 * l21
    v2 = 1.0 / math.sqrt(p2)
    l30 = (store[at3] - sums[3][0]) * v0
    l31 = (store[at3 + _1] - sums[3][1] - l30 * l10) * v1
    l32 = (store[at3 + _2] - sums[3][2] - l30 * l20 - l31 * l21) * v2
    p3 = store[at3 + _3] - sums[3][3] - l30 * l30 - l31 * l31 - l32 * l32
    store[at1], store[at2], store[at2 + _1] = l10, l20, l21
    store[at3], store[at3 + _1], store[at3 + _2] = l30, l31, l32
    inverse[c], inverse[c + _1], inverse[c + _2], inverse[c + _3] = v0, v1, v2, 1.0 / math.sqrt(p3)
    return p0 > 0.0 and p1 > 0.0 and p2 > 0.0 and p3 > 0.0  # false where one is not a number


@kernel(reorder_sums=True)
def factorise(values: Vector, entries: TileEntries, shift: float, size: int, factor: TileFactor) -> bool:
    """Fill the factor with L of A + shift 1; return whether that is positive definite.

    Entries e of A are values[source[e]] at place[e]; rows beyond `size` are those of the identity.
    """
    start, first, store, inverse = factor.start, factor.first, factor.store, factor.inverse
    for i in range(np.uint64(start.shape[0])):
        wide_i = _4 * (i - first[i] + _1)
        store[start[i] : start[i] + _4 * wide_i] = 0.0
        for e in range(entries.first[i], entries.first[i + _1]):
            store[entries.place[e]] = values[entries.source[e]]
        for r in range(_4):
            store[start[i] + r * wide_i + wide_i - _4 + r] += shift if _4 * i + r < np.uint64(size) else 1.0
        for j in range(first[i], i):
            begin = max(first[i], first[j])
            wide_j = _4 * (j - first[j] + _1)
            a, b = start[i] + _4 * (begin - first[i]), start[j] + _4 * (begin - first[j])
            sums = _products(store, a, wide_i, b, wide_j, _4 * (j - begin))
            at, to1 = start[i] + _4 * (j - first[i]), start[j] + wide_j - _4 + wide_j
            to2, to3, c = to1 + wide_j, to1 + _2 * wide_j, _4 * j
            below = store[to1], store[to2], store[to2 + _1], store[to3], store[to3 + _1], store[to3 + _2]
            scale = inverse[c], inverse[c + _1], inverse[c + _2], inverse[c + _3]
            _finish_row(store, at, sums[0], below, scale)
            _finish_row(store, at + wide_i, sums[1], below, scale)
            _finish_row(store, at + _2 * wide_i, sums[2], below, scale)
            _finish_row(store, at + _3 * wide_i, sums[3], below, scale)
        a = start[i]
        sums = _products(store, a, wide_i, a, wide_i, wide_i - _4)
        if not _finish_diagonal(store, a + wide_i - _4, wide_i, inverse, _4 * i, sums):
            return False
    return True


@device_function
def _substitute_forward(factor: Any, begin: Any, x: Any) -> None:
    start, first, store, inverse = factor.start, factor.first, factor.store, factor.inverse
    zero = store.dtype.type(0.0)  # sums have the precision of the factor
    for i in range(begin, np.uint64(start.shape[0])):
        wide, column, e = _4 * (i - first[i] + _1), _4 * first[i], _4 * i
        a, count = start[i], wide - _4
        b, c, d = a + wide, a + _2 * wide, a + _3 * wide
        s0 = s1 = s2 = s3 = zero
        for k in range(count):
            value = x[column + k]
            s0 += store[a + k] * value
            s1 += store[b + k] * value
            s2 += store[c + k] * value
            s3 += store[d + k] * value
        b, c, d = b + count, c + count, d + count
        x0 = (x[e] - s0) * inverse[e]
        x1 = (x[e + _1] - s1 - store[b] * x0) * inverse[e + _1]
        x2 = (x[e + _2] - s2 - store[c] * x0 - store[c + _1] * x1) * inverse[e + _2]
        x3 = x[e + _3] - s3 - store[d] * x0 - store[d + _1] * x1 - store[d + _2] * x2
        x[e], x[e + _1], x[e + _2], x[e + _3] = x0, x1, x2, x3 * inverse[e + _3]


@device_function
def _substitute_backward(factor: Any, x: Any) -> None:
    start, first, store, inverse = factor.start, factor.first, factor.store, factor.inverse
    groups = np.uint64(start.shape[0])
    for step in range(groups):
        i = groups - _1 - step
        wide, column, e = _4 * (i - first[i] + _1), _4 * first[i], _4 * i
        a, count = start[i], wide - _4
        b, c, d = a + wide, a + _2 * wide, a + _3 * wide
        bb, cc, dd = b + count, c + count, d + count
        x3 = x[e + _3] * inverse[e + _3]
        x2 = (x[e + _2] - store[dd + _2] * x3) * inverse[e + _2]
        x1 = (x[e + _1] - store[cc + _1] * x2 - store[dd + _1] * x3) * inverse[e + _1]
        x0 = (x[e] - store[bb] * x1 - store[cc] * x2 - store[dd] * x3) * inverse[e]
        for k in range(count):
            x[column + k] -= store[a + k] * x0 + store[b + k] * x1 + store[c + k] * x2 + store[d + k] * x3
        x[e], x[e + _1], x[e + _2], x[e + _3] = x0, x1, x2, x3


@device_function
def turned(values: Matrix, turn: Matrix) -> None:
    """Multiply the rows of values (n, 3) by turn (3, 3) from the right, in place."""
    for i in range(values.shape[0]):
        a, b, c = values[i, 0], values[i, 1], values[i, 2]
        for r in range(3):
            values[i, r] = a * turn[0, r] + b * turn[1, r] + c * turn[2, r]


@allocating
def _substitute(factor: Any, dofs: Indices, turn: Matrix, loads: Blocks) -> None:
    x = np.zeros(4 * factor.start.shape[0], factor.store.dtype)
    turn_back = turn.T.copy()
    for case in range(loads.shape[0]):
        turned(loads[case], turn)
        values = loads[case].reshape(-1)
        for e in range(dofs.shape[0]):
            x[e] = values[dofs[e]]
        _substitute_forward(factor, np.uint64(0), x)
        _substitute_backward(factor, x)
        values[:] = 0.0
        for e in range(dofs.shape[0]):
            values[dofs[e]] = x[e]
        turned(loads[case], turn_back)


@kernel(reorder_sums=True, allocates=True)
def substitute(factor: TileFactor, dofs: Indices, turn: Matrix, loads: Blocks) -> None:
    """Solve in place for each of loads (k, n, 3), turned before and back after; equation e is dofs[e]."""
    _substitute(factor, dofs, turn, loads)


@kernel(reorder_sums=True, allocates=True)
def substitute_singly(factor: SingleFactor, dofs: Indices, turn: Matrix, loads: Blocks) -> None:
    """Solve as `substitute` does, in single precision."""
    _substitute(factor, dofs, turn, loads)


@kernel(reorder_sums=True)
def forward(factor: TileFactor, dofs: Indices, loads: Matrix, solutions: Matrix) -> None:
    """Fill found (k, 4 tiles), zero before, with L^-1 b of each of loads (k, 3 n); equation e is dofs[e]."""
    for case in range(loads.shape[0]):
        begin = dofs.shape[0]
        for e in range(dofs.shape[0] - 1, -1, -1):
            solutions[case, e] = loads[case, dofs[e]]
            if solutions[case, e] != 0.0:
                begin = e
        _substitute_forward(factor, np.uint64(begin // 4), solutions[case])
