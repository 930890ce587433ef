"""Node groups that a scenario names by rings and corners, and what holds or loads them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.config.schema.name_patterns import matching
from cosim.config.schema.phase import ForceTable, SupportTable
from cosim.soft.body.body import SoftBody

_AXES = "xyz"

SidesOf: TypeAlias = Callable[[str], int]
"""Name of a ring -> how many corners it has."""


def nodes_of(
    body: SoftBody, sides_of: SidesOf, rings: Sequence[str], corners: Sequence[int] | None
) -> IntArray:
    """Return the nodes (m,) of rings, ascending, or only those at some corners.

    Args:
        body: whose nodes.
        sides_of: name of a ring -> its corners.
        rings: names, or patterns of names.
        corners: 0 to sides - 1; None for all nodes of the rings.
    """
    found = []
    for name in (name for pattern in rings for name in matching(pattern, body.rings)):
        ring = body.rings[name]
        found.append(
            ring if corners is None else ring[np.array(corners, np.int64) * len(ring) // sides_of(name)]
        )
    return np.unique(np.concatenate([np.zeros(0, np.int64), *found]))


def held_components(body: SoftBody, sides_of: SidesOf, supports: Sequence[SupportTable]) -> Mask:
    """Return (n, 3) bool, the world components that supports hold."""
    held = np.zeros((body.nodes, 3), dtype=bool)
    for support in supports:
        nodes = nodes_of(body, sides_of, support.rings, support.corners)
        for axis in support.axes:
            held[nodes, _AXES.index(axis)] = True
    return held


def nodal_force(body: SoftBody, sides_of: SidesOf, forces: Sequence[ForceTable]) -> Array:
    """Return (n, 3) [N], each force shared evenly by its nodes."""
    total = np.zeros((body.nodes, 3))
    for force in forces:
        nodes = nodes_of(body, sides_of, force.rings, force.corners)
        total[nodes] += np.array(force.total_N) / len(nodes)
    return total
