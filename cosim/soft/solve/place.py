"""Where on a body something is, in words."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.soft.solve.newton import NewtonSolver


def place_of_largest(solver: NewtonSolver, positions: Array) -> str:
    """Return the node where the largest residual is, and the ring nearest to it.

    Args:
        solver: whose system was evaluated last where it has ended.
        positions: (n, 3) [m], there.
    """
    body = solver.system.body
    size = np.where(solver.free, np.abs(solver.system.gradient), 0.0).max(axis=1)
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
