"""Nested dissection: an order of elimination for large meshes, as a tree of separators.

A connected part is cut by the fewest nodes between both ends of its breadth-first order; of the two smallest
cuts, the one with the smaller size^1.5 / (size of the smaller side) is used. Each side is cut again, and
eliminated before the cut. Couplings across the mesh, such as those of a cable's eyelets, would blur the
order: it does not follow them, and nodes that they couple across a cut are added to it. The fewest nodes
of a cut follow from a maximum flow: every node that may be cut is an arc of capacity one, every edge one of
unlimited capacity.
Sources: George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 8;
Ford and Fulkerson, Flows in Networks, 1962, chapter I.11 (Menger's theorem).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import scipy

from cosim.base.frames import IntArray, Mask

Graph: TypeAlias = "scipy.sparse.csr_matrix"
_LEAF_NODES = 40  # size up to which parts are not cut
_END = 0.2  # fraction of the nodes, at either end, that is not cut


def dissect(graph: Graph, tied: IntArray, most: int) -> list[IntArray]:
    """Return groups of nodes in the order of their elimination; a group is eliminated together.

    Args:
        graph: (n, n) adjacency, symmetric.
        tied: nodes that are coupled across the mesh.
        most: largest number of nodes in a group.
    """
    couples_far = np.zeros(graph.shape[0], dtype=bool)
    couples_far[tied] = True
    return [
        piece
        for group in _parts(graph, np.arange(len(couples_far)), couples_far)
        for piece in _pieces(graph, group, most)
    ]


def _pieces(graph: Graph, group: IntArray, largest_size: int) -> list[IntArray]:
    """Return a group in parts of at most `largest_size` nodes, neighbours together."""
    if len(group) <= largest_size:
        return [group] if len(group) else []
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(graph[group][:, group].tocsr(), True)
    return [np.asarray(piece) for piece in np.array_split(group[order], -(-len(group) // largest_size))]


def _parts(graph: Graph, nodes: IntArray, couples_far: Mask) -> list[IntArray]:
    """Return the groups of some nodes in the order of their elimination."""
    if len(nodes) <= _LEAF_NODES:
        return [nodes]
    inner = graph[nodes][:, nodes].tocsr()
    count, label = scipy.sparse.csgraph.connected_components(inner, directed=False)
    if count > 1:
        return [group for k in range(count) for group in _parts(graph, nodes[label == k], couples_far)]
    cut = _best_cut(inner, couples_far[nodes])
    if cut is None:
        return [nodes]
    return [*_parts(graph, nodes[~cut], couples_far), nodes[cut]]


def _best_cut(graph: Graph, couples_far: Mask) -> Mask | None:
    """Return the nodes of the best cut of a connected graph; None for a graph without a cut."""
    row, column = np.repeat(np.arange(graph.shape[0]), np.diff(graph.indptr)), graph.indices
    order = _order(graph, row, couples_far)
    end = max(1, int(_END * len(order)))
    first, last = (np.zeros(len(order), dtype=bool) for _ in range(2))
    first[order[:end]], last[order[-end:]] = True, True
    # a coupling from end to end can only be cut at one of its nodes
    ties = np.unique(row[first[row] & last[column]])
    first[ties] = False
    if not first.any():
        return None
    least_cost, best_cut = np.inf, None
    tied = np.zeros(len(order), dtype=bool)
    tied[ties] = True
    for nodes in least_cuts(_without(graph, row, tied), first, last | tied):
        cut = tied.copy()
        cut[nodes] = True
        side_size = _side(graph, row, cut, first)
        smaller = min(side_size, len(order) - int(cut.sum()) - side_size)
        cost = int(cut.sum()) ** 1.5 / smaller if smaller > 0 else np.inf
        if cost < least_cost:
            least_cost, best_cut = cost, cut
    return best_cut


def _without(graph: Graph, row: IntArray, removed: Mask) -> Graph:
    """Return the graph without the edges of some nodes."""
    stays = ~(removed[row] | removed[graph.indices])
    ties = np.ones(int(stays.sum())), (row[stays], graph.indices[stays])
    return scipy.sparse.csr_matrix(ties, shape=graph.shape)


def _side(graph: Graph, row: IntArray, cut: Mask, first: Mask) -> int:
    """Return the number of nodes on the side of `first` after a cut."""
    _, label = scipy.sparse.csgraph.connected_components(_without(graph, row, cut), directed=False)
    return int((np.isin(label, label[first]) & ~cut).sum())


def _order(graph: Graph, row: IntArray, couples_far: Mask) -> IntArray:
    """Return all nodes in order of their distance from a peripheral node."""
    short = ~(couples_far[row] & couples_far[graph.indices])
    ties = np.ones(int(short.sum())), (row[short], graph.indices[short])
    mesh_graph = scipy.sparse.csr_matrix(ties, shape=graph.shape)
    order: IntArray = np.zeros(1, dtype=np.int64)
    search = scipy.sparse.csgraph.breadth_first_order
    for searched in (mesh_graph, graph):
        end = 0
        for _ in range(3):
            order = search(searched, end, directed=False, return_predecessors=False)
            end = int(order[-1])
        if len(order) == graph.shape[0]:
            break
    return order


def least_cuts(graph: Graph, near: Mask, far: Mask) -> tuple[IntArray, IntArray]:
    """Return the smallest cut nearest to `near` and that nearest to `far`; both have the same size.

    Args:
        graph: (n, n) adjacency, symmetric.
        near: (n,) nodes on one side; none has an edge to `far`.
        far: (n,) nodes on the other side.
    """
    row, column = np.repeat(np.arange(graph.shape[0]), np.diff(graph.indptr)), graph.indices
    between = np.flatnonzero(~(near | far))
    count = len(between)
    local = np.full(graph.shape[0], -1)
    local[between] = np.arange(count)
    a, b = local[row], local[column]
    within = (a >= 0) & (b >= 0)
    entries, exits = np.unique(b[near[row] & (b >= 0)]), np.unique(a[far[column] & (a >= 0)])
    # node i is the arc from i to count + i
    source, sink = 2 * count, 2 * count + 1
    tail = [np.arange(count), count + a[within], np.full(len(entries), source), count + exits]
    head = [count + np.arange(count), b[within], entries, np.full(len(exits), sink)]
    capacity = np.full(sum(len(tails) for tails in tail), count + 1, dtype=np.int32)
    capacity[:count] = 1
    shape = (2 * count + 2,) * 2
    arcs = scipy.sparse.csr_matrix((capacity, (np.concatenate(tail), np.concatenate(head))), shape=shape)
    spare = arcs - scipy.sparse.csgraph.maximum_flow(arcs, source, sink).flow
    spare.data[spare.data < 0] = 0
    spare.eliminate_zeros()
    reached, reaching = _reached(spare, source), _reached(spare.T.tocsr(), sink)
    first = reached[:count] & ~reached[count:-2]
    last = reaching[count:-2] & ~reaching[:count]
    return between[first], between[last]


def _reached(arcs: Graph, start: int) -> Mask:
    """Return the nodes (n,) that arcs reach."""
    is_reached = np.zeros(arcs.shape[0], dtype=bool)
    is_reached[scipy.sparse.csgraph.breadth_first_order(arcs, start, return_predecessors=False)] = True
    return is_reached
