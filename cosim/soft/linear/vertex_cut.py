"""The fewest nodes that part a graph: a minimum vertex cut, as a maximum flow.

Every node that may be cut becomes an arc of capacity one, every tie an arc without bound (Menger's theorem).
Source: Ford and Fulkerson, Flows in Networks, 1962, chapter I.11.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from cosim.base.frames import IntArray, Mask


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
