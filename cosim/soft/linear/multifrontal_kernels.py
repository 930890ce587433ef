"""Kernels of the factorisation by fronts (see `dissected_cholesky`): a factorisation, a substitution.

A front's own columns, p of them, are assembled in `work`. Its factor is kept as L_pp^-1 and W, row by row.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from cosim.base.kernels import Places, PlaceTable, Vector, allocating, device_function, kernel
from cosim.soft.linear.elimination_tree import CHILD, COLUMNS, ENTRY, FIRST, LEFT, REST, RUN, START

# Places are unsigned, as in `envelope_kernels`.
_0, _1, _2, _3, _4, _WIDE = (np.uint64(n) for n in (0, 1, 2, 3, 4, COLUMNS))


class FrontLists(NamedTuple):
    """The fronts of a matrix, see `FrontTree`.

    Args:
        fronts: (k + 1, 7), where what belongs to each begins.
        children: of each front.
        runs: columns in one stretch, that a child leaves to its parent.
        rows: where the rest of each front is in its parent.
    """

    fronts: PlaceTable
    children: Places
    runs: PlaceTable
    rows: Places


class FrontRoom(NamedTuple):
    """Room for a factorisation.

    Args:
        work: a front's own columns.
        spare: the same, and twice its components.
        stack: what fronts leave to their parents.
        store: the factor, filled.
    """

    work: Vector
    spare: Vector
    stack: Vector
    store: Vector


@device_function
def _invert(own: Vector, p: Any, inverse: Vector, scale: Vector, row: Vector) -> bool:
    """Turn A_pp (p, p) into L and write L^-1 to inverse; False where A_pp is not positive definite."""
    for i in range(p):
        at = i * p
        for j in range(i):
            other, total = j * p, own[at + j]
            for k in range(j):
                total -= own[at + k] * own[other + k]
            own[at + j] = total * scale[j]
        pivot = own[at + i]
        for k in range(i):
            pivot -= own[at + k] * own[at + k]
        if not pivot > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(pivot)
    for i in range(p):
        at = i * p
        for j in range(p):
            row[j] = 0.0
        for k in range(i):
            share, other = own[at + k] * scale[i], k * p
            for j in range(k + _1):
                row[j] -= share * inverse[other + j]
        row[i] = scale[i]
        for j in range(p):
            inverse[at + j] = row[j]
    return True


@device_function
def _take(lists: FrontLists, k: Any, owned: Any, stack: Vector, to: Vector, grid: tuple[Any, Any]) -> None:
    """Add what the children of front k leave: to the columns it owns, or to its rest.

    grid: width of the rows there, and rows before the first of them.
    """
    fronts, children, runs, rows = lists.fronts, lists.children, lists.runs, lists.rows
    wide, back = grid
    for place in range(fronts[k, CHILD], fronts[k + _1, CHILD]):
        child = children[place]
        begin, left = fronts[child, REST], fronts[child, LEFT]
        count = fronts[child + _1, REST] - begin
        for r in range(fronts[child, RUN], fronts[child + _1, RUN]):
            if runs[r, 4] != owned:
                continue
            column, end, here, there = runs[r, 0], runs[r, 1], left + runs[r, 2], runs[r, 3]
            for i in range(column, count):
                source, target = here + _WIDE * i, there + wide * (rows[begin + i] - back)
                for j in range(min(i + _1, end) - column):
                    to[target + j] += stack[source + j]


@allocating
def _leave(below: Vector, q: Any, p: Any, factor: Vector, left: Vector) -> None:
    """Write -W^T to the factor and -W W^T to left, both by groups of rows of W (q, p)."""
    at, to, room = _0, _0, p * _WIDE
    for first in range(_0, q, _WIDE):
        count = q - first
        for k in range(p):
            for j in range(_WIDE):
                factor[to + k * _WIDE + j] = -below[(first + j) * p + k] if j < count else 0.0
        rest = below[first * p : q * p].reshape((np.int64(count), np.int64(p)))
        group = factor[to : to + room].reshape((np.int64(p), np.int64(_WIDE)))
        out = left[at : at + count * _WIDE].reshape((np.int64(count), np.int64(_WIDE)))
        np.dot(rest, group, out)
        at, to = at + count * _WIDE, to + room


@kernel(reorder_sums=True, allocates=True)
def factorise(
    values: Vector, source: Places, place: Places, shift: float, lists: FrontLists, room: FrontRoom
) -> bool:
    """Fill the store; return whether the matrix is positive definite.

    Entry place[e] of a front's own columns is values[source[e]].
    """
    fronts, work, spare, stack, store = lists.fronts, room.work, room.spare, room.stack, room.store
    for k in range(np.uint64(fronts.shape[0]) - _1):
        p, q = fronts[k + _1, FIRST] - fronts[k, FIRST], fronts[k + _1, REST] - fronts[k, REST]
        at, square = fronts[k, START], p * p
        work[: p * (p + q)] = 0.0
        for e in range(fronts[k, ENTRY], fronts[k + _1, ENTRY]):
            work[place[e]] = values[source[e]]
        for i in range(p):
            work[i * (p + _1)] += shift
        _take(lists, k, _1, stack, work, (p, _0))
        if not _invert(work, p, store[at : at + square], spare[:p], spare[p : p + p]):
            return False
        if q == _0:
            continue
        shape, width = (np.int64(q), np.int64(p)), np.int64(p)
        turned = spare[:square].reshape((width, width))
        for i in range(p):
            for j in range(p):
                turned[j, i] = store[at + i * p + j]
        below = spare[square : p * (p + q)]
        np.dot(work[square : p * (p + q)].reshape(shape), turned, below.reshape(shape))
        left = stack[fronts[k, LEFT] :]
        _leave(below, q, p, store[at + square :], left)
        _take(lists, k, _0, stack, left, (_WIDE, p))
    return True


@device_function
def _add_product(store: Vector, at: Any, count: Any, wide: Any, x: Vector, y: Vector) -> None:
    """Add M x to y, M (count, wide) at a place of the store."""
    for i in range(_0, count & ~_3, _4):
        a = at + i * wide
        b, c, d = a + wide, a + _2 * wide, a + _3 * wide
        s0 = s1 = s2 = s3 = 0.0
        for k in range(wide):
            value = x[k]
            s0 += store[a + k] * value
            s1 += store[b + k] * value
            s2 += store[c + k] * value
            s3 += store[d + k] * value
        y[i] += s0
        y[i + _1] += s1
        y[i + _2] += s2
        y[i + _3] += s3
    for i in range(count & ~_3, count):
        a, total = at + i * wide, 0.0
        for k in range(wide):
            total += store[a + k] * x[k]
        y[i] += total


@device_function
def _add_transposed(store: Vector, at: Any, count: Any, p: Any, x: Vector, y: Vector) -> None:
    """Add M^T x to y, M (count, p) at a place of the store."""
    for i in range(_0, count & ~_3, _4):
        a = at + i * p
        b, c, d = a + p, a + _2 * p, a + _3 * p
        x0, x1, x2, x3 = x[i], x[i + _1], x[i + _2], x[i + _3]
        for k in range(p):
            y[k] += store[a + k] * x0 + store[b + k] * x1 + store[c + k] * x2 + store[d + k] * x3
    for i in range(count & ~_3, count):
        a, value = at + i * p, x[i]
        for k in range(p):
            y[k] += store[a + k] * value


@kernel(reorder_sums=True)
def substitute(
    store: Vector, fronts: PlaceTable, rest: Places, here: Vector, there: Vector, x: Vector
) -> None:
    """Solve for x (size,) in place; `here` and `there` are room for a front's components and its rest."""
    count = np.uint64(fronts.shape[0]) - _1
    for k in range(count):
        first, start, begin = fronts[k, FIRST], fronts[k, START], fronts[k, REST]
        p, q = fronts[k + _1, FIRST] - first, fronts[k + _1, REST] - begin
        for i in range(p):
            here[i] = x[first + i]
        there[:p] = 0.0
        _add_product(store, start, p, p, here, there)
        for i in range(p):
            here[i] = x[first + i] = there[i]
        at = start + p * p
        for group in range(_0, q, _WIDE):
            there[:_WIDE] = 0.0
            _add_transposed(store, at, p, _WIDE, here, there)
            for i in range(min(_WIDE, q - group)):
                x[rest[begin + group + i]] += there[i]
            at += p * _WIDE
    for done in range(count):
        back = count - _1 - done
        first, start, begin = fronts[back, FIRST], fronts[back, START], fronts[back, REST]
        p, q = fronts[back + _1, FIRST] - first, fronts[back + _1, REST] - begin
        at = start + p * p
        for i in range(p):
            here[i], x[first + i] = x[first + i], 0.0
        for group in range(_0, q, _WIDE):
            there[:_WIDE] = 0.0
            for i in range(min(_WIDE, q - group)):
                there[i] = x[rest[begin + group + i]]
            _add_product(store, at, p, _WIDE, there, here)
            at += p * _WIDE
        _add_transposed(store, start, p, p, here, x[first : first + p])
