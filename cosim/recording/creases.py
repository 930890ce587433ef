"""Sharp edges of the drawn shape, drawn as lines so that an evenly coloured film keeps its form."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.geometry.surface import dihedral_angle, interior_hinges


def crease_lines(positions: Array, triangles: IntArray) -> list[IntArray]:
    """Return the edges that fold outward by less than a right angle, joined into lines.

    On a drawn chamber these are the welds between its films.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3) node indices, outward orientation.

    Returns:
        Node indices of each line; closed lines end with their first node.
    """
    hinges = interior_hinges(triangles)
    edges = hinges[dihedral_angle(positions, hinges) < 0.5 * np.pi, 1:3]
    neighbours: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    # Open lines first, from their ends; what is left then are closed ones.
    starts = sorted(neighbours, key=lambda node: len(neighbours[node]) == 2)
    lines = (_walk(start, neighbours) for start in starts)
    return [np.array(line) for line in lines if len(line) > 1]


def _walk(start: int, neighbours: dict[int, list[int]]) -> list[int]:
    """Follow edges from a node as far as they go, and use them up."""
    line = [start]
    while neighbours[line[-1]]:
        here, there = line[-1], neighbours[line[-1]].pop()
        neighbours[there].remove(here)
        line.append(there)
    return line
