"""Finer meshes of the same drawn shape."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.surface import directed_edges


def refine(mesh: NamedMesh, levels: int) -> NamedMesh:
    """Return the mesh with each triangle cut into four, `levels` times.

    New nodes are edge midpoints of the drawn shape, so area, volume and rest angles stay; the new
    edges inside a triangle are flat. Rings and caps gain the midpoints of their edges, lines keep their
    nodes, and the parts of a triangle are in its face groups and have its face values. Nodes are
    numbered by the mean number of the coarse nodes they come from, which keeps the half bandwidth
    near 4 per level times the coarse one: it stays unit-wise.

    Args:
        mesh: the coarse mesh.
        levels: >= 0.

    Raises:
        MeshError: levels is negative.
    """
    if levels < 0:
        raise MeshError(f"refinement levels is {levels}; it must be >= 0")
    for _ in range(levels):
        mesh = _refine_once(mesh)
    return mesh


def _refine_once(mesh: NamedMesh) -> NamedMesh:
    n = len(mesh.positions)
    edges, inverse = np.unique(np.sort(directed_edges(mesh.triangles), axis=1), axis=0, return_inverse=True)
    rank = np.concatenate([np.arange(n), edges.mean(axis=1)])
    number = np.empty(len(rank), dtype=np.int64)
    number[np.argsort(rank, kind="stable")] = np.arange(len(rank))
    positions = np.empty((len(rank), 3))
    positions[number] = np.concatenate([mesh.positions, mesh.positions[edges].mean(axis=1)])

    middle = {(int(a), int(b)): int(number[n + e]) for e, (a, b) in enumerate(edges)}
    return mesh.divided(
        positions=positions,
        triangles=_quarters(number[mesh.triangles], number[n + inverse.reshape(-1, 3)]),
        parent=np.repeat(np.arange(len(mesh.triangles)), 4),
        rings={name: _with_midpoints(ring, number, middle) for name, ring in mesh.rings.items()},
        caps=tuple(_with_midpoints(cap, number, middle) for cap in mesh.caps),
        lines={name: number[line] for name, line in mesh.lines.items()},
    )


def _quarters(corners: IntArray, midpoints: IntArray) -> IntArray:
    """Triangles (m, 3) and midpoints of their edges ab, bc, ca (m, 3) -> (4 m, 3), siblings together."""
    a, b, c = corners.T
    ab, bc, ca = midpoints.T
    children = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(child, axis=1) for child in children], axis=1).reshape(-1, 3)


def _with_midpoints(ring: IntArray, number: IntArray, middle: dict[tuple[int, int], int]) -> IntArray:
    pairs = zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True)
    extended = [(int(number[a]), middle[min(a, b), max(a, b)]) for a, b in pairs]
    return np.array(extended, dtype=np.int64).ravel()
