"""Groups of nodes that a scenario selects by rings and corners, to hold or load them."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.config.schema.phase import ForceTable, SupportTable
from cosim.config.toml.keys import matching
from cosim.soft.body.body import SoftBody

_AXES = "xyz"
SidesOf: TypeAlias = Callable[[str], int]
"""Name of a ring -> its number of corners."""


def nodes_of(
    body: SoftBody, sides_of: SidesOf, rings: Sequence[str], corners: Sequence[int] | None
) -> IntArray:
    """Return the nodes (m,) of rings, ascending, or only those at some corners.

    Args:
        body: with the rings.
        sides_of: name of a ring -> its number of corners.
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
    """Return a mask (n, 3) of the world components of nodes that supports hold."""
    held = np.zeros((body.nodes, 3), dtype=bool)
    for support in supports:
        nodes = nodes_of(body, sides_of, support.rings, support.corners)
        for axis in support.axes:
            held[nodes, _AXES.index(axis)] = True
    return held


def nodal_force(body: SoftBody, sides_of: SidesOf, forces: Sequence[ForceTable]) -> Array:
    """Return nodal forces (n, 3) [N], world axes; each force is divided evenly among its nodes."""
    total = np.zeros((body.nodes, 3))
    for force in forces:
        nodes = nodes_of(body, sides_of, force.rings, force.corners)
        total[nodes] += np.array(force.total_N) / len(nodes)
    return total
