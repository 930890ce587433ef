"""Where on a body something is, in words."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.soft.body.body import SoftBody


def place_of_largest(body: SoftBody, positions: Array, gradient: Array, free: Mask) -> str:
    """Return the node where the largest residual is, and the ring nearest to it.

    Args:
        body: whose residual it is.
        positions: (n, 3) [m].
        gradient: (n, 3) [N], of the potential there.
        free: (n, 3) bool, components that move.
    """
    size = np.where(free, np.abs(gradient), 0.0).max(axis=1)
    node = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
    if not body.rings:
        return f"node {node}"
    own = [name for name, nodes in body.rings.items() if node in nodes]
    if own:
        return f"node {node} of {own[0]}"
    away = {
        name: np.linalg.norm(positions[nodes] - positions[node], axis=1).min()
        for name, nodes in body.rings.items()
    }
    return f"node {node} near {min(away, key=lambda name: float(away[name]))}"
