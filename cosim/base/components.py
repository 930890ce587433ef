"""Connected components of graphs."""

import numpy as np

from cosim.base.frames import IntArray


def components(count: int, edges: IntArray) -> IntArray:
    """Return the component (count,) of each node, numbered from 0 in the order of their first nodes.

    Args:
        count: nodes.
        edges: (m, 2) pairs of nodes, in either direction.
    """
    first = np.arange(count)  # a node of the same component, in the end its first
    while True:
        ends = first[edges]
        low, high = ends.min(axis=1), ends.max(axis=1)
        if np.array_equal(low, high):
            return np.unique(first, return_inverse=True)[1]
        np.minimum.at(first, high, low)
        while not np.array_equal(first, above := first[first]):
            first = above
