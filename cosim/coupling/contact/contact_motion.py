"""How points move with rigid bodies, and how forces at contact points come to the film's nodes."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, IntArray


def rigid_motions(points: Array, origins: Array) -> Array:
    """Return how points (k, 3) [m] move (k, 3, 6) with translation and rotation about origins: [1, -S(arm)].

    Args:
        points: (k, 3) [m].
        origins: (3,) [m], of all, or (k, 3), of each.
    """
    motion = np.zeros((len(points), 3, 6))
    motion[:, :, :3] = np.eye(3)
    x, y, z = (points - origins).T
    motion[:, 0, 4], motion[:, 0, 5] = z, -y
    motion[:, 1, 3], motion[:, 1, 5] = -z, x
    motion[:, 2, 3], motion[:, 2, 4] = y, -x
    return motion


def spread(nodes: IntArray, weights: Array, push: Array, count: int) -> Array:
    """Return forces (j, n, 3) [N] on nodes from forces at contact points.

    Args:
        nodes: (k, 3) that each point combines.
        weights: (k, 3).
        push: (k, 3, j) [N], j cases.
        count: n.
    """
    total = np.zeros((count, push.shape[2], 3))
    for a in range(nodes.shape[1]):
        np.add.at(total, nodes[:, a], weights[:, a, None, None] * push.transpose(0, 2, 1))
    return np.ascontiguousarray(total.transpose(1, 0, 2))
