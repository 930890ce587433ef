"""The fronts of a sparse Cholesky factorisation in numbers: what each eliminates, hands on, and where.

Front k eliminates its own p components and hands what is left of q others, its rest, on to its parent: the
front that owns the first of them. Row i of a front is the i-th of both together.

Nested dissection: an order of elimination for large meshes, as a tree of separators.

A connected part is cut by the fewest nodes between both ends of its breadth-first order: of the two cuts that
are found, the one with the less size^1.5 / (size of the smaller side). What is on either side is cut again,
and eliminated before it. Nodes that tie far places together, such as the eyelets of a cable, would blur the
order: it does not follow these ties, and what they tie across a cut is cut as well. The fewest nodes of a cut
are a maximum flow: every node that may be cut becomes an arc of capacity one, every tie an arc without bound.
Sources: George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 8;
Ford and Fulkerson, Flows in Networks, 1962, chapter I.11 (Menger's theorem).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    maximum_flow,
    reverse_cuthill_mckee,
)

from cosim.base.frames import IntArray, Mask

_LEAF_NODES = 40  # parts no larger are not cut
_END = 0.2  # share of the nodes, at either end, that a cut leaves alone


def dissect(graph: csr_matrix, tied: IntArray, most: int) -> list[IntArray]:
    """Return groups of nodes in the order of their elimination, each eliminated in one go.

    Args:
        graph: (n, n) adjacency, symmetric.
        tied: nodes that are tied together across the mesh.
        most: nodes of a group.
    """
    far = np.zeros(graph.shape[0], dtype=bool)
    far[tied] = True
    return [
        piece for group in _parts(graph, np.arange(len(far)), far) for piece in _pieces(graph, group, most)
    ]


def _pieces(graph: csr_matrix, group: IntArray, most: int) -> list[IntArray]:
    """Return a group in pieces of at most so many nodes, neighbours together."""
    if len(group) <= most:
        return [group] if len(group) else []
    order = reverse_cuthill_mckee(graph[group][:, group].tocsr(), True)
    return [np.asarray(piece) for piece in np.array_split(group[order], -(-len(group) // most))]


def _parts(graph: csr_matrix, nodes: IntArray, far: Mask) -> list[IntArray]:
    """Return the groups of some nodes in the order of their elimination."""
    if len(nodes) <= _LEAF_NODES:
        return [nodes]
    inner = graph[nodes][:, nodes].tocsr()
    count, label = connected_components(inner, directed=False)
    if count > 1:
        return [group for k in range(count) for group in _parts(graph, nodes[label == k], far)]
    cut = _best_cut(inner, far[nodes])
    if cut is None:
        return [nodes]
    return [*_parts(graph, nodes[~cut], far), nodes[cut]]


def _best_cut(graph: csr_matrix, far: Mask) -> Mask | None:
    """Return which nodes part a connected graph best; None where there is nothing to part."""
    row, column = np.repeat(np.arange(graph.shape[0]), np.diff(graph.indptr)), graph.indices
    order = _order(graph, row, far)
    end = max(1, int(_END * len(order)))
    first, last = (np.zeros(len(order), dtype=bool) for _ in range(2))
    first[order[:end]], last[order[-end:]] = True, True
    # a tie from end to end can only be cut at one of them
    ties = np.unique(row[first[row] & last[column]])
    first[ties] = False
    if not first.any():
        return None
    least, best = np.inf, None
    tied = np.zeros(len(order), dtype=bool)
    tied[ties] = True
    for found in least_cuts(_without(graph, row, tied), first, last | tied):
        cut = tied.copy()
        cut[found] = True
        side = _side(graph, row, cut, first)
        smaller = min(side, len(order) - int(cut.sum()) - side)
        cost = int(cut.sum()) ** 1.5 / smaller if smaller > 0 else np.inf
        if cost < least:
            least, best = cost, cut
    return best


def _without(graph: csr_matrix, row: IntArray, gone: Mask) -> csr_matrix:
    """Return the graph without the ties of some nodes."""
    kept = ~(gone[row] | gone[graph.indices])
    return csr_matrix((np.ones(int(kept.sum())), (row[kept], graph.indices[kept])), shape=graph.shape)


def _side(graph: csr_matrix, row: IntArray, cut: Mask, first: Mask) -> int:
    """Return how many nodes a cut leaves together with those of `first`."""
    _, label = connected_components(_without(graph, row, cut), directed=False)
    return int((np.isin(label, label[first]) & ~cut).sum())


def _order(graph: csr_matrix, row: IntArray, far: Mask) -> IntArray:
    """Return all nodes, those first that are near to one that is far from all others."""
    short = ~(far[row] & far[graph.indices])
    plain = csr_matrix((np.ones(int(short.sum())), (row[short], graph.indices[short])), shape=graph.shape)
    order: IntArray = np.zeros(1, dtype=np.int64)
    for walked in (plain, graph):
        end = 0
        for _ in range(3):
            order = breadth_first_order(walked, end, directed=False, return_predecessors=False)
            end = int(order[-1])
        if len(order) == graph.shape[0]:
            break
    return order


def least_cuts(graph: csr_matrix, near: Mask, far: Mask) -> tuple[IntArray, IntArray]:
    """Return the least cut next to `near` and the one next to `far`; both have the same size.

    Args:
        graph: (n, n) adjacency, symmetric.
        near: (n,) nodes on one side; none of them is tied to one of `far`.
        far: (n,) nodes on the other side.
    """
    row, column = np.repeat(np.arange(graph.shape[0]), np.diff(graph.indptr)), graph.indices
    between = np.flatnonzero(~(near | far))
    count = len(between)
    local = np.full(graph.shape[0], -1)
    local[between] = np.arange(count)
    a, b = local[row], local[column]
    within = (a >= 0) & (b >= 0)
    entered, left = np.unique(b[near[row] & (b >= 0)]), np.unique(a[far[column] & (a >= 0)])
    # node i is the arc from i to count + i
    source, sink = 2 * count, 2 * count + 1
    tail = [np.arange(count), count + a[within], np.full(len(entered), source), count + left]
    head = [count + np.arange(count), b[within], entered, np.full(len(left), sink)]
    capacity = np.full(sum(len(part) for part in tail), count + 1, dtype=np.int32)
    capacity[:count] = 1
    shape = (2 * count + 2,) * 2
    arcs = csr_matrix((capacity, (np.concatenate(tail), np.concatenate(head))), shape=shape)
    spare = arcs - maximum_flow(arcs, source, sink).flow
    spare.data[spare.data < 0] = 0
    spare.eliminate_zeros()
    reached, reaching = _reached(spare, source), _reached(spare.T.tocsr(), sink)
    first = reached[:count] & ~reached[count:-2]
    last = reaching[count:-2] & ~reaching[:count]
    return between[first], between[last]


def _reached(arcs: csr_matrix, start: int) -> Mask:
    """Return which nodes (n,) arcs lead to."""
    found = np.zeros(arcs.shape[0], dtype=bool)
    found[breadth_first_order(arcs, start, return_predecessors=False)] = True
    return found


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
