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
        own = np.array([int((number[group] >= 0).sum()) for group in groups])
        first = np.cumsum([0, *own])
        count = np.array([len(rest) for rest in rests])
        rows = [
            _rows(rest, int(first[k]), int(own[k]), rests[k]) if k >= 0 else np.zeros(0, np.int64)
            for rest, k in zip(rests, parent, strict=True)
        ]
        rest_first, place = np.cumsum([0, *count]), np.concatenate(rows)
        run_first, runs = _runs(place, rest_first, own[parent], count[parent])
        by_parent = np.argsort(parent, kind="stable")
        by_parent = by_parent[parent[by_parent] >= 0]
        left, stack = _stacked(count, parent)
        padded = COLUMNS * -(-count // COLUMNS)
        return cls(
            first, np.cumsum([0, *(own * (own + padded))]), rest_first, np.concatenate(rests), place,
            np.searchsorted(parent[by_parent], np.arange(len(groups) + 1)), by_parent, left, run_first, runs,
            stack,
        )  # fmt: skip

    def place(self, row: IntArray, column: IntArray) -> tuple[IntArray, IntArray]:
        """Return the front of each entry (row >= column) of the matrix, and its index in that front."""
        front = np.searchsorted(self.first, column, side="right") - 1
        size, own = self.first[-1], np.diff(self.first)
        key = np.repeat(np.arange(len(own)), np.diff(self.rest_first)) * size + self.rest
        below = own[front] + np.searchsorted(key, front * size + row) - self.rest_first[front]
        at = np.where(row < self.first[front + 1], row - self.first[front], below)
        return front, at * own[front] + column - self.first[front]


def _present(number: IntArray) -> IntArray:
    return np.asarray(number[number >= 0])


def _rests(graph: Graph, groups: list[IntArray]) -> tuple[list[IntArray], IntArray]:
    """Return the rest of each group, as indices in the order of elimination, and its parent, -1 for none."""
    order, ends = np.concatenate(groups), np.cumsum([len(group) for group in groups])
    ordered = graph[order][:, order]
    places, begins = ordered.indices.astype(np.int64), ordered.indptr[[0, *ends]]
    passed: list[list[IntArray]] = [[] for _ in groups]
    rests, parent = [], np.full(len(groups), -1)
    for k in range(len(groups)):
        tied = np.unique(np.concatenate([places[begins[k] : begins[k + 1]], *passed[k]]))
        rest = tied[np.searchsorted(tied, ends[k]) :]
        if len(rest):
            parent[k] = np.searchsorted(ends, rest[0], side="right")
            passed[parent[k]].append(rest)
        rests.append(rest)
    return rests, parent


def _rows(rest: IntArray, first: int, own: int, parents_rest: IntArray) -> IntArray:
    """Return the rows of a rest in its parent, which owns the components from `first` on."""
    return np.asarray(np.where(rest < first + own, rest - first, own + np.searchsorted(parents_rest, rest)))


def column_places(columns: IntArray, count: int | IntArray) -> IntArray:
    """Return the index of entries (0, column) in a stored Schur complement of `count` components."""
    group, within = columns // COLUMNS, columns % COLUMNS
    # the group begins with its row group * COLUMNS, after sum_h<g COLUMNS (count - COLUMNS h)
    begin = COLUMNS * (group * count - COLUMNS * (group * (group - 1) // 2))
    return np.asarray(begin - COLUMNS * COLUMNS * group + within)


def _runs(place: IntArray, first: IntArray, own: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Return the start of each rest's runs, and all runs.

    Args:
        place: rows of all rests in their parents.
        first: (fronts + 1,), start of each rest.
        own: (fronts,) components that the parent of each owns.
        count: (fronts,) components of the parent's rest.
    """
    size = np.diff(first)
    size, begin, own, count = (np.repeat(part, size) for part in (size, first[:-1], own, count))
    columns, owned = np.arange(len(place)) - begin, place < own
    here = column_places(columns, size)
    there = np.where(owned, place, column_places(place - own, count))
    new = columns == 0
    new[1:] |= (np.diff(here) != 1) | (np.diff(there) != 1) | (np.diff(owned) != 0)
    start = np.flatnonzero(new)
    end = columns[np.append(start[1:], len(place))[: len(start)] - 1] + 1
    runs = np.stack([columns[start], end, here[start], there[start], owned[start]], axis=1)
    return np.searchsorted(start, first), runs.astype(np.int64)


def length_left(count: int) -> int:
    """Return the stored length of a Schur complement of `count` components."""
    groups = -(-count // COLUMNS)
    return COLUMNS * (groups * count - COLUMNS * (groups * (groups - 1) // 2))


def _stacked(count: IntArray, parent: IntArray) -> tuple[IntArray, int]:
    """Return the stack index of each front's Schur complement, and the size of the stack."""
    at, length = np.zeros(len(count), dtype=np.int64), 0
    waiting: list[tuple[int, int, int]] = []
    for k, own in enumerate(count):
        wanted, begin = length_left(int(own)), 0
        for taken, end, _ in sorted(waiting):
            if taken - begin >= wanted:
                break
            begin = max(begin, end)
        at[k], length = begin, max(length, begin + wanted)
        waiting = [entry for entry in waiting if parent[entry[2]] != k]
        if wanted:
            waiting.append((begin, begin + wanted, k))
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
def _invert(own: Vector, p: Any, inverse: Vector, scale: Vector, row: Vector) -> bool:
    """Turn A_pp (p, p) into L and write L^-1 to inverse; return False if A_pp is not positive definite."""
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
def _add_children(
    lists: FrontLists, k: Any, owned: Any, stack: Vector, to: Vector, grid: tuple[Any, Any]
) -> None:
    """Add the Schur complements of the children of front k, to its columns or to its rest.

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
def _fill_complement(below: Vector, q: Any, p: Any, factor: Vector, left: Vector) -> None:
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
        left = stack[fronts[k, LEFT] :]
        _fill_complement(below, q, p, store[at + square :], left)
        _add_children(lists, k, _0, stack, left, (_WIDE, p))
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
    """Solve for x (size,) in place; `here` and `there` are workspace for a front's components and rest."""
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
