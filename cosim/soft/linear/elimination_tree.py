"""The fronts of a sparse Cholesky factorisation in numbers: what each eliminates, hands on, and where.

Front k eliminates its own p components and hands what is left of q others, its rest, on to its parent: the
front that owns the first of them. Row i of a front is the i-th of both together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.sparse import csr_matrix

from cosim.base.frames import IntArray

COLUMNS = 32  # of what is left, stored next to one another
# Columns of the kernels' table of fronts: where each begins in the lists below, in the store and the stack.
FIRST, START, REST, CHILD, RUN, ENTRY, LEFT = range(7)


@final
@dataclass(frozen=True)
class FrontTree:
    """All fronts in the order of elimination; components are numbered in that order.

    What is left of a front are the entries (i, j), i >= j, of its rest. It is stored by groups of COLUMNS
    columns: entry (i, j) is at begin[j // COLUMNS] + COLUMNS i + j % COLUMNS, see `column_places`.

    Args:
        first: (fronts + 1,) first component of each.
        start: (fronts + 1,) where the factor of each begins: rows of p, its own, then those of its rest.
        rest_first: (fronts + 1,) where each begins in `rest`.
        rest: components of the rest.
        rows: of those, their rows in the parent.
        child_first: (fronts + 1,) where each begins in `children`.
        children: fronts that hand on to each.
        left: (fronts,) where what is left of each begins in the stack.
        run_first: (fronts + 1,) where each begins in `runs`.
        runs: (r, 5) first and last + 1 column of a rest that stay next to one another in the parent, where
            the first of them is in what is left of the front and in the parent, and whether the parent owns
            them.
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
    def of(cls, graph: csr_matrix, groups: list[IntArray], number: IntArray) -> FrontTree:
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
        runs = [_runs(place, int(own[k]), int(count[k])) for place, k in zip(rows, parent, strict=True)]
        by_parent = np.argsort(parent, kind="stable")
        by_parent = by_parent[parent[by_parent] >= 0]
        left, stack = _stacked(count, parent)
        padded = COLUMNS * -(-count // COLUMNS)
        return cls(
            first, np.cumsum([0, *(own * (own + padded))]), np.cumsum([0, *count]), np.concatenate(rests),
            np.concatenate(rows), np.searchsorted(parent[by_parent], np.arange(len(groups) + 1)), by_parent,
            left, np.cumsum([0, *(len(run) for run in runs)]), np.concatenate(runs), stack,
        )  # fmt: skip

    def place(self, row: IntArray, column: IntArray) -> tuple[IntArray, IntArray]:
        """Return the front of each entry (row >= column) of the matrix, and where in its columns it is."""
        front = np.searchsorted(self.first, column, side="right") - 1
        size, own = self.first[-1], np.diff(self.first)
        key = np.repeat(np.arange(len(own)), np.diff(self.rest_first)) * size + self.rest
        below = own[front] + np.searchsorted(key, front * size + row) - self.rest_first[front]
        at = np.where(row < self.first[front + 1], row - self.first[front], below)
        return front, at * own[front] + column - self.first[front]


def _present(number: IntArray) -> IntArray:
    return np.asarray(number[number >= 0])


def _rests(graph: csr_matrix, groups: list[IntArray]) -> tuple[list[IntArray], IntArray]:
    """Return the rest of each group, as places in the order of elimination, and its parent; -1 for none."""
    order = np.concatenate(groups)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    ends = np.cumsum([len(group) for group in groups])
    handed: list[list[IntArray]] = [[] for _ in groups]
    rests, parent = [], np.full(len(groups), -1)
    for k, group in enumerate(groups):
        tied = np.unique(np.concatenate([place[graph[group].indices], *handed[k]]))
        rest = tied[np.searchsorted(tied, ends[k]) :]
        if len(rest):
            parent[k] = np.searchsorted(ends, rest[0], side="right")
            handed[parent[k]].append(rest)
        rests.append(rest)
    return rests, parent


def _rows(rest: IntArray, first: int, own: int, parents_rest: IntArray) -> IntArray:
    """Return the rows of a rest in its parent, which owns the components from `first` on."""
    return np.asarray(np.where(rest < first + own, rest - first, own + np.searchsorted(parents_rest, rest)))


def column_places(columns: IntArray, count: int) -> IntArray:
    """Return where what is left of `count` components has the entries (0, column), were they stored."""
    group, within = columns // COLUMNS, columns % COLUMNS
    # the group begins with its row group * COLUMNS, after sum_h<g COLUMNS (count - COLUMNS h)
    begin = COLUMNS * (group * count - COLUMNS * (group * (group - 1) // 2))
    return np.asarray(begin - COLUMNS * COLUMNS * group + within)


def _runs(place: IntArray, own: int, count: int) -> IntArray:
    """Return the runs of a rest with these rows in a parent of `own` and `count` components."""
    columns = np.arange(len(place))
    owned = place < own
    here = column_places(columns, len(place))
    there = np.where(owned, place, column_places(place - own, count))
    new = np.ones(len(place), dtype=bool)
    new[1:] = (np.diff(here) != 1) | (np.diff(there) != 1) | (np.diff(owned) != 0)
    begin = np.flatnonzero(new)
    end = np.append(begin[1:], len(place))[: len(begin)]
    return np.stack([begin, end, here[begin], there[begin], owned[begin]], axis=1).astype(np.int64)


def length_left(count: int) -> int:
    """Return the length of what is left of so many components."""
    groups = -(-count // COLUMNS)
    return COLUMNS * (groups * count - COLUMNS * (groups * (groups - 1) // 2))


def _stacked(count: IntArray, parent: IntArray) -> tuple[IntArray, int]:
    """Return where what is left of each front waits for its parent, and the room that all of them need."""
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
