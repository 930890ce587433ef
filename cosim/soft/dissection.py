"""Nested dissection: an order of elimination for large meshes, as a tree of separators.

A connected part is cut by a level of its breadth-first search from an end: the one with the least
size^1.5 / (size of the smaller side). What is on either side is cut again, and eliminated before it. Nodes
that tie far places together, such as the eyelets of a cable, would blur the levels: they are kept out and
eliminated last.
Source: George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, shortest_path

from cosim.frames import IntArray

_LEAF_NODES = 20  # parts no larger are eliminated in one go
_SMALLER_SIDE = 0.1  # least share of the nodes


@final
@dataclass(frozen=True)
class Front:
    """Nodes eliminated together, and those that they are then tied to.

    Args:
        nodes: (p,) eliminated here.
        rest: (q,) eliminated later, in the order of their elimination.
        parent: index of the front that takes over what is left; -1 for none.
    """

    nodes: IntArray
    rest: IntArray
    parent: int


def dissect(graph: csr_matrix, last: IntArray) -> tuple[Front, ...]:
    """Return the fronts of a graph in the order of their elimination.

    Args:
        graph: (n, n) adjacency, symmetric.
        last: nodes to eliminate last.
    """
    among = np.ones(graph.shape[0], dtype=bool)
    among[last] = False
    groups = [group for group in [*_parts(graph, np.flatnonzero(among)), np.unique(last)] if len(group)]
    return _with_fill(graph, groups)


def _parts(graph: csr_matrix, nodes: IntArray) -> list[IntArray]:
    """Return the groups of some nodes in the order of their elimination."""
    if len(nodes) <= _LEAF_NODES:
        return [nodes]
    inner = graph[nodes][:, nodes]
    count, label = connected_components(inner, directed=False)
    if count > 1:
        return [group for k in range(count) for group in _parts(graph, nodes[label == k])]
    level = _levels(inner)
    # what touches nothing beyond its level stays on the near side
    row = np.repeat(np.arange(len(nodes)), np.diff(inner.indptr))
    reaching = np.zeros(len(nodes), dtype=bool)
    reaching[row[level[inner.indices] > level[row]]] = True
    size = np.bincount(level[reaching], minlength=level.max() + 1)
    below = np.cumsum(np.bincount(level))
    smaller = np.minimum(below - size, len(nodes) - below)
    possible = np.flatnonzero(smaller >= max(1.0, _SMALLER_SIDE * len(nodes)))
    if not len(possible):
        return [nodes]
    cut = int(possible[np.argmin(size[possible] ** 1.5 / smaller[possible])])
    separator = (level == cut) & reaching
    near, far = (level <= cut) & ~separator, level > cut
    return [*_parts(graph, nodes[near]), *_parts(graph, nodes[far]), nodes[separator]]


def _levels(graph: csr_matrix) -> IntArray:
    """Return the distance of each node from one that is far from all others."""
    end = 0
    for _ in range(2):
        end = int(breadth_first_order(graph, end, directed=False, return_predecessors=False)[-1])
    return np.asarray(shortest_path(graph, unweighted=True, directed=False, indices=end), dtype=np.int64)


def _with_fill(graph: csr_matrix, groups: list[IntArray]) -> tuple[Front, ...]:
    owner = np.empty(graph.shape[0], dtype=np.int64)
    for k, group in enumerate(groups):
        owner[group] = k
    handed: list[list[IntArray]] = [[] for _ in groups]
    fronts = []
    for k, group in enumerate(groups):
        tied = np.unique(np.concatenate([graph[group].indices, *handed[k]]))
        rest = tied[owner[tied] > k]
        rest = rest[np.lexsort((rest, owner[rest]))]
        parent = int(owner[rest[0]]) if len(rest) else -1
        if parent >= 0:
            handed[parent].append(rest)
        fronts.append(Front(group, rest, parent))
    return tuple(fronts)
