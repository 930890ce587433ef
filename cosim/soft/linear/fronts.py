"""Multifrontal factorisation: the tree of fronts, and the kernels that factorise and substitute.

Front k eliminates its p components and passes the Schur complement of q others, its rest, to its parent: the
front that owns the first of them. Row i of a front is the i-th of both together. A front's p columns are
assembled in `work`; its factor is stored as L_pp^-1 and W, row by row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernel_types import Places, PlaceTable, Vector
from cosim.base.kernels import allocating, device_function, kernel
from cosim.soft.linear.dissection import Graph

COLUMNS = 32  # columns of a Schur complement that are stored together
# Columns of the kernels' table of fronts: where each begins in the lists below, in the store and the stack.
FIRST, START, REST, CHILD, RUN, ENTRY, LEFT = range(7)


@final
@dataclass(frozen=True)
class FrontTree:
    """All fronts in the order of elimination; components are numbered in that order.

    The Schur complement of a front has the entries (i, j), i >= j, of its rest. It is stored by groups of
    COLUMNS columns: entry (i, j) is at begin[j // COLUMNS] + COLUMNS i + j % COLUMNS, see `column_places`.

    Args:
        first: (fronts + 1,), first component of each front.
        start: (fronts + 1,), start of each front's factor: rows of its p components, then of its rest.
        rest_first: (fronts + 1,), start of each front in `rest`.
        rest: components of the rests.
        rows: row of each of them in the parent.
        child_first: (fronts + 1,), start of each front in `children`.
        children: fronts with Schur complements for each.
        left: (fronts,), start of each front's Schur complement in the stack.
        run_first: (fronts + 1,), start of each front in `runs`.
        runs: (r, 5): first and last + 1 column of a rest that are neighbours in the parent too, index of the
            first in the Schur complement and in the parent, and whether the parent owns them.
        stack: length of the stack.
    """

    first: IntArray
    start: IntArray
    rest_first: IntArray
    rest: IntArray
    rows: IntArray
    child_first: IntArray
    children: IntArray
    left: IntArray
    run_first: IntArray
    runs: IntArray
    stack: int

    @classmethod
    def of(cls, graph: Graph, groups: list[IntArray], number: IntArray) -> FrontTree:
        """Return the fronts of groups of nodes.

        Args:
            graph: (n, n) adjacency, symmetric.
            groups: of nodes in the order of elimination.
            number: (n, 3) component of each, -1 for none, in the same order.
        """
        ranked, parent = _rests(graph, groups)
        order = np.concatenate(groups)
        rests = [_present(number[order[rest]]) for rest in ranked]
        owned = np.array([int((number[group] >= 0).sum()) for group in groups])
        first = np.cumsum([0, *owned])
        count = np.array([len(rest) for rest in rests])
        rows = [
            _rows(rest, int(first[k]), int(owned[k]), rests[k]) if k >= 0 else np.zeros(0, np.int64)
            for rest, k in zip(rests, parent, strict=True)
        ]
        rest_first, rows_in_parents = np.cumsum([0, *count]), np.concatenate(rows)
        run_first, runs = _runs(rows_in_parents, rest_first, owned[parent], count[parent])
        by_parent = np.argsort(parent, kind="stable")
        by_parent = by_parent[parent[by_parent] >= 0]
        stack_starts, stack = _stacked(count, parent)
        padded = COLUMNS * -(-count // COLUMNS)
        return cls(
            first, np.cumsum([0, *(owned * (owned + padded))]), rest_first, np.concatenate(rests),
            rows_in_parents, np.searchsorted(parent[by_parent], np.arange(len(groups) + 1)), by_parent,
            stack_starts, run_first, runs, stack,
        )  # fmt: skip

    def place(self, row: IntArray, column: IntArray) -> tuple[IntArray, IntArray]:
        """Return the front of each entry (row >= column) of the matrix, and its index in that front."""
        front = np.searchsorted(self.first, column, side="right") - 1
        size, owned = self.first[-1], np.diff(self.first)
        key = np.repeat(np.arange(len(owned)), np.diff(self.rest_first)) * size + self.rest
        below = owned[front] + np.searchsorted(key, front * size + row) - self.rest_first[front]
        at = np.where(row < self.first[front + 1], row - self.first[front], below)
        return front, at * owned[front] + column - self.first[front]


def _present(number: IntArray) -> IntArray:
    return np.asarray(number[number >= 0])


def _rests(graph: Graph, groups: list[IntArray]) -> tuple[list[IntArray], IntArray]:
    """Return the rest of each group, as indices in the order of elimination, and its parent, -1 for none."""
    order, ends = np.concatenate(groups), np.cumsum([len(group) for group in groups])
    ordered = graph[order][:, order]
    columns, begins = ordered.indices.astype(np.int64), ordered.indptr[[0, *ends]]
    rests_of_children: list[list[IntArray]] = [[] for _ in groups]
    rests, parent = [], np.full(len(groups), -1)
    for k in range(len(groups)):
        tied = np.unique(np.concatenate([columns[begins[k] : begins[k + 1]], *rests_of_children[k]]))
        rest = tied[np.searchsorted(tied, ends[k]) :]
        if len(rest):
            parent[k] = np.searchsorted(ends, rest[0], side="right")
            rests_of_children[parent[k]].append(rest)
        rests.append(rest)
    return rests, parent


def _rows(rest: IntArray, first: int, owned: int, parents_rest: IntArray) -> IntArray:
    """Return the rows of a rest in its parent, which owns the components from `first` on."""
    return np.asarray(
        np.where(rest < first + owned, rest - first, owned + np.searchsorted(parents_rest, rest))
    )


def column_places(columns: IntArray, count: int | IntArray) -> IntArray:
    """Return the index of entries (0, column) in a stored Schur complement of `count` components."""
    group, within = columns // COLUMNS, columns % COLUMNS
    # the group begins with its row group * COLUMNS, after sum_h<g COLUMNS (count - COLUMNS h)
    begin = COLUMNS * (group * count - COLUMNS * (group * (group - 1) // 2))
    return np.asarray(begin - COLUMNS * COLUMNS * group + within)


def _runs(
    rows: IntArray, first: IntArray, parent_owns: IntArray, count: IntArray
) -> tuple[IntArray, IntArray]:
    """Return the start of each rest's runs, and all runs.

    Args:
        rows: of all rests in their parents.
        first: (fronts + 1,), start of each rest.
        parent_owns: (fronts,) components that the parent of each owns.
        count: (fronts,) components of the parent's rest.
    """
    size = np.diff(first)
    size, begin, parent_owns, count = (
        np.repeat(values, size) for values in (size, first[:-1], parent_owns, count)
    )
    columns, owned = np.arange(len(rows)) - begin, rows < parent_owns
    source = column_places(columns, size)
    target = np.where(owned, rows, column_places(rows - parent_owns, count))
    begins_run = columns == 0
    begins_run[1:] |= (np.diff(source) != 1) | (np.diff(target) != 1) | (np.diff(owned) != 0)
    start = np.flatnonzero(begins_run)
    end = columns[np.append(start[1:], len(rows))[: len(start)] - 1] + 1
    runs = np.stack([columns[start], end, source[start], target[start], owned[start]], axis=1)
    return np.searchsorted(start, first), runs.astype(np.int64)


def length_left(count: int) -> int:
    """Return the stored length of a Schur complement of `count` components."""
    groups = -(-count // COLUMNS)
    return COLUMNS * (groups * count - COLUMNS * (groups * (groups - 1) // 2))


def _stacked(count: IntArray, parent: IntArray) -> tuple[IntArray, int]:
    """Return the stack index of each front's Schur complement, and the size of the stack."""
    at, length = np.zeros(len(count), dtype=np.int64), 0
    waiting: list[tuple[int, int, int]] = []
    for k, rest_size in enumerate(count):
        needed, begin = length_left(int(rest_size)), 0
        for occupied_from, end, _ in sorted(waiting):
            if occupied_from - begin >= needed:
                break
            begin = max(begin, end)
        at[k], length = begin, max(length, begin + needed)
        waiting = [span for span in waiting if parent[span[2]] != k]
        if needed:
            waiting.append((begin, begin + needed, k))
    return at, length


# Indices are unsigned, as in `envelope_kernels`.
_0, _1, _2, _3, _4, _WIDE = (np.uint64(n) for n in (0, 1, 2, 3, 4, COLUMNS))


class FrontLists(NamedTuple):
    """The fronts of a matrix, see `FrontTree`.

    Args:
        fronts: (k + 1, 7), starts of each front in the lists below, in the store and in the stack.
        children: of each front.
        runs: neighbouring columns of Schur complements.
        rows: rows of each front's rest in its parent.
    """

    fronts: PlaceTable
    children: Places
    runs: PlaceTable
    rows: Places


class FrontRoom(NamedTuple):
    """Workspace of a factorisation.

    Args:
        work: a front's columns.
        spare: the same, and twice its components.
        stack: Schur complements that wait for their parents.
        store: the factor, filled.
    """

    work: Vector
    spare: Vector
    stack: Vector
    store: Vector


@device_function
def _invert(matrix: Vector, p: Any, inverse: Vector, scale: Vector, row: Vector) -> bool:
    """Turn A_pp (p, p) into L and write L^-1 to inverse; return False if A_pp is not positive definite."""
    for i in range(p):
        at = i * p
        for j in range(i):
            other_row, total = j * p, matrix[at + j]
            for k in range(j):
                total -= matrix[at + k] * matrix[other_row + k]
            matrix[at + j] = total * scale[j]
        pivot = matrix[at + i]
        for k in range(i):
            pivot -= matrix[at + k] * matrix[at + k]
        if not pivot > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(pivot)
    for i in range(p):
        at = i * p
        for j in range(p):
            row[j] = 0.0
        for k in range(i):
            multiplier, other_row = matrix[at + k] * scale[i], k * p
            for j in range(k + _1):
                row[j] -= multiplier * inverse[other_row + j]
        row[i] = scale[i]
        for j in range(p):
            inverse[at + j] = row[j]
    return True


@device_function
def _add_children(
    lists: FrontLists, k: Any, owned: Any, stack: Vector, into: Vector, grid: tuple[Any, Any]
) -> None:
    """Add the Schur complements of the children of front k, to its columns or to its rest.

    grid: width of the rows there, and rows before the first of them.
    """
    fronts, children, runs, rows = lists.fronts, lists.children, lists.runs, lists.rows
    row_width, rows_before = grid
    for child_index in range(fronts[k, CHILD], fronts[k + _1, CHILD]):
        child = children[child_index]
        begin, stack_begin = fronts[child, REST], fronts[child, LEFT]
        count = fronts[child + _1, REST] - begin
        for r in range(fronts[child, RUN], fronts[child + _1, RUN]):
            if runs[r, 4] != owned:
                continue
            column, end, source_begin = runs[r, 0], runs[r, 1], stack_begin + runs[r, 2]
            target_begin = runs[r, 3]
            for i in range(column, count):
                source = source_begin + _WIDE * i
                target = target_begin + row_width * (rows[begin + i] - rows_before)
                for j in range(min(i + _1, end) - column):
                    into[target + j] += stack[source + j]


@allocating
def _fill_complement(below: Vector, q: Any, p: Any, factor: Vector, complement: Vector) -> None:
    """Write -W^T to the factor and -W W^T to left, both by groups of rows of W (q, p)."""
    at, factor_at, room = _0, _0, p * _WIDE
    for first in range(_0, q, _WIDE):
        count = q - first
        for k in range(p):
            for j in range(_WIDE):
                factor[factor_at + k * _WIDE + j] = -below[(first + j) * p + k] if j < count else 0.0
        rest = below[first * p : q * p].reshape((np.int64(count), np.int64(p)))
        group = factor[factor_at : factor_at + room].reshape((np.int64(p), np.int64(_WIDE)))
        product = complement[at : at + count * _WIDE].reshape((np.int64(count), np.int64(_WIDE)))
        np.dot(rest, group, product)
        at, factor_at = at + count * _WIDE, factor_at + room


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
        _add_children(lists, k, _1, stack, work, (p, _0))
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
        complement = stack[fronts[k, LEFT] :]
        _fill_complement(below, q, p, store[at + square :], complement)
        _add_children(lists, k, _0, stack, complement, (_WIDE, p))
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
    store: Vector, fronts: PlaceTable, rest: Places, own_values: Vector, rest_values: Vector, x: Vector
) -> None:
    """Solve for x (size,) in place; `own_values` and `rest_values` are workspace for a front."""
    count = np.uint64(fronts.shape[0]) - _1
    for k in range(count):
        first, start, begin = fronts[k, FIRST], fronts[k, START], fronts[k, REST]
        p, q = fronts[k + _1, FIRST] - first, fronts[k + _1, REST] - begin
        for i in range(p):
            own_values[i] = x[first + i]
        rest_values[:p] = 0.0
        _add_product(store, start, p, p, own_values, rest_values)
        for i in range(p):
            own_values[i] = x[first + i] = rest_values[i]
        at = start + p * p
        for group in range(_0, q, _WIDE):
            rest_values[:_WIDE] = 0.0
            _add_transposed(store, at, p, _WIDE, own_values, rest_values)
            for i in range(min(_WIDE, q - group)):
                x[rest[begin + group + i]] += rest_values[i]
            at += p * _WIDE
    for step in range(count):
        front = count - _1 - step
        first, start, begin = fronts[front, FIRST], fronts[front, START], fronts[front, REST]
        p, q = fronts[front + _1, FIRST] - first, fronts[front + _1, REST] - begin
        at = start + p * p
        for i in range(p):
            own_values[i], x[first + i] = x[first + i], 0.0
        for group in range(_0, q, _WIDE):
            rest_values[:_WIDE] = 0.0
            for i in range(min(_WIDE, q - group)):
                rest_values[i] = x[rest[begin + group + i]]
            _add_product(store, at, p, _WIDE, rest_values, own_values)
            at += p * _WIDE
        _add_transposed(store, start, p, p, own_values, x[first : first + p])
