"""Finer meshes of the same drawn shape: triangles cut in four, those beside them closed by fewer parts.

Source: R. E. Bank, A. H. Sherman, A. Weiser, "Refinement algorithms and data structures for regular local
mesh refinement", Scientific Computing (1983): red triangles are cut in four, green ones close the mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.surface import directed_edges

_ALIKE = 1e-6  # relative


def refine(mesh: NamedMesh, levels: int) -> NamedMesh:
    """Return the mesh with each triangle cut into four, `levels` times; see `refine_some`.

    The half bandwidth grows by a factor near 4 per level.

    Args:
        mesh: the coarse mesh.
        levels: >= 0.

    Raises:
        MeshError: levels is negative.
    """
    if levels < 0:
        raise MeshError(f"refinement levels is {levels}; it must be >= 0")
    for _ in range(levels):
        mesh = refine_some(mesh, lambda edges: np.ones(len(edges), dtype=bool))
    return mesh


def refine_some(
    mesh: NamedMesh, chosen: Callable[[IntArray], Mask], fractions: Callable[[IntArray], Array] | None = None
) -> NamedMesh:
    """Return the mesh with some edges cut, and triangles into one part more than they have cut edges.

    A triangle with all edges cut becomes four that are alike; one with two cut edges becomes three, by the
    shorter diagonal beyond the corner between them, or four where both are alike, so that no choice breaks a
    symmetry; one with one becomes two. New nodes lie on edges of the
    drawn shape, so area, volume and rest angles stay; the new edges inside a triangle are flat. Rings and
    caps gain the new nodes of their edges, lines keep their nodes, and the parts of a triangle are in its
    face groups and have its face values. Nodes are numbered by the mean number of the coarse nodes they come
    from, unit-wise.

    Args:
        mesh: the coarse mesh.
        chosen: edges (k, 2), as nodes -> (k,), which are cut.
        fractions: edges (k, 2) -> fraction (k,) of the way to the second node at which they are; None: 1/2.
    """
    n = len(mesh.positions)
    edges, sides = np.unique(np.sort(directed_edges(mesh.triangles), axis=1), axis=0, return_inverse=True)
    sides = sides.reshape(-1, 3)
    points = mesh.positions[edges].mean(axis=1)
    if fractions is not None:
        first, second = mesh.positions[edges[:, 0]], mesh.positions[edges[:, 1]]
        points = first + fractions(edges)[:, None] * (second - first)
    cut, diagonals = _unambiguous(mesh, sides, points, chosen(edges))
    ends = edges[cut]
    rank = np.concatenate([np.arange(n), ends.mean(axis=1)])
    number = np.empty(len(rank), dtype=np.int64)
    number[np.argsort(rank, kind="stable")] = np.arange(len(rank))
    positions = np.empty((len(rank), 3))
    positions[number] = np.concatenate([mesh.positions, points[cut]])

    node_of_edge = np.full(len(edges), -1)
    node_of_edge[cut] = number[n:]
    parts = _parts(number[mesh.triangles], node_of_edge[sides], diagonals)
    middle = {(int(a), int(b)): int(node) for (a, b), node in zip(ends, number[n:], strict=True)}
    return mesh.divided(
        positions=positions,
        triangles=parts.triangles,
        parent=parts.parent,
        rings={name: _with_new_nodes(ring, number, middle) for name, ring in mesh.rings.items()},
        caps=tuple(_with_new_nodes(cap, number, middle) for cap in mesh.caps),
        lines={name: number[line] for name, line in mesh.lines.items()},
    )


class _Parts(NamedTuple):
    """Parts (k, 3) of triangles, those of one next to each other, and the triangle (k,) each comes from."""

    triangles: IntArray
    parent: IntArray


def _unambiguous(mesh: NamedMesh, sides: IntArray, points: Array, cut: Mask) -> tuple[Mask, Array]:
    """Return which edges are cut, more where diagonals are alike, and the diagonals (m, 2) [m].

    Args:
        mesh: whose triangles (m, 3).
        sides: (m, 3) edges of each.
        points: (k, 3) [m], where edges would be cut.
        cut: (k,), which are.
    """
    while True:
        first = (~cut[sides]).argmax(axis=1)  # of a triangle with two cut edges the one that is whole
        (a, b, _), (_, bc, ca) = _turned(mesh.triangles, first), _turned(sides, first)
        ends = ((mesh.positions[a], points[bc]), (mesh.positions[b], points[ca]))
        diagonals = np.stack([np.linalg.norm(p - q, axis=1) for p, q in ends], axis=1)
        alike = np.ptp(diagonals, axis=1) < _ALIKE * diagonals[:, 0]
        more = alike & (cut[sides].sum(axis=1) == 2)
        if not more.any():
            return cut, diagonals
        cut = cut.copy()
        cut[sides[more]] = True


def _parts(corners: IntArray, new: IntArray, diagonals: Array) -> _Parts:
    """Return the parts of triangles (m, 3), given the new nodes on edges ab, bc, ca (m, 3) or -1."""
    count = (new >= 0).sum(axis=1)
    of = [np.flatnonzero(count == cuts) for cuts in range(4)]
    found = [
        corners[of[0]][:, None],
        _halves(corners[of[1]], new[of[1]]),
        _thirds(corners[of[2]], new[of[2]], diagonals[of[2]]),
        _quarters(corners[of[3]], new[of[3]]),
    ]
    parent = np.concatenate([np.repeat(own, cuts + 1) for cuts, own in enumerate(of)])
    order = np.argsort(parent, kind="stable")
    return _Parts(np.concatenate([part.reshape(-1, 3) for part in found])[order], parent[order])


def _turned(table: IntArray, first: IntArray) -> list[IntArray]:
    """Return the columns of a table (m, 3), each row begun at its own column."""
    row = np.arange(len(table))
    return [table[row, (first + k) % 3] for k in range(3)]


def _halves(corners: IntArray, new: IntArray) -> IntArray:
    """Triangles (m, 3) with one edge cut -> (m, 2, 3)."""
    first = (new >= 0).argmax(axis=1)
    a, b, c = _turned(corners, first)
    ab, _, _ = _turned(new, first)
    return np.stack([np.stack(child, axis=1) for child in ((a, ab, c), (ab, b, c))], axis=1)


def _thirds(corners: IntArray, new: IntArray, diagonals: Array) -> IntArray:
    """Triangles (m, 3) with two edges cut -> (m, 3, 3): a corner, and a part cut by its shorter diagonal."""
    first = (new < 0).argmax(axis=1)  # so that ab is whole
    a, b, c = _turned(corners, first)
    _, bc, ca = _turned(new, first)
    shorter = (diagonals[:, 0] < diagonals[:, 1])[:, None, None]
    from_a = np.stack([np.stack(child, axis=1) for child in ((a, b, bc), (a, bc, ca), (bc, c, ca))], axis=1)
    from_b = np.stack([np.stack(child, axis=1) for child in ((a, b, ca), (b, bc, ca), (bc, c, ca))], axis=1)
    return np.where(shorter, from_a, from_b)


def _quarters(corners: IntArray, new: IntArray) -> IntArray:
    """Triangles (m, 3) with all edges cut -> (m, 4, 3)."""
    a, b, c = corners.T
    ab, bc, ca = new.T
    children = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(child, axis=1) for child in children], axis=1)


def _with_new_nodes(ring: IntArray, number: IntArray, middle: dict[tuple[int, int], int]) -> IntArray:
    nodes: list[int] = []
    for a, b in zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True):
        between = middle.get((min(a, b), max(a, b)))
        nodes += [int(number[a])] if between is None else [int(number[a]), between]
    return np.array(nodes, dtype=np.int64)
