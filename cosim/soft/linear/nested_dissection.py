"""Nested dissection: an order of elimination for large meshes, as a tree of separators.

A connected part is cut by the fewest nodes between both ends of its breadth-first order: of the two cuts that
are found, the one with the less size^1.5 / (size of the smaller side). What is on either side is cut again,
and eliminated before it. Nodes that tie far places together, such as the eyelets of a cable, would blur the
order: it does not follow these ties, and what they tie across a cut is cut as well. The fewest nodes of a cut
are a maximum flow: every node that may be cut becomes an arc of capacity one, every tie an arc without bound.
Sources: George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 8;
Ford and Fulkerson, Flows in Networks, 1962, chapter I.11 (Menger's theorem).
"""

from __future__ import annotations

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
