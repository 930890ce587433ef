"""Meshes of simple shapes, with the components that their planes of symmetry hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask


@final
@dataclass(frozen=True)
class Shape:
    """A triangulated shape.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3), outward.
        symmetry: (n, 3) bool, components held by planes of symmetry through the origin.
    """

    positions: Array
    triangles: IntArray
    symmetry: Mask


def on_symmetry_planes(positions: Array, axes: tuple[int, ...]) -> Mask:
    """Return (n, 3) bool: component a of the nodes on the plane where coordinate a is zero.

    Args:
        positions: (n, 3) [m].
        axes: coordinates a whose planes are planes of symmetry.
    """
    size = float(np.abs(positions).max())
    held = np.zeros(positions.shape, dtype=bool)
    for axis in axes:
        held[:, axis] = np.abs(positions[:, axis]) < 1e-9 * size
    return held


def sector_lattice(rings: int, sectors: int) -> tuple[IntArray, Array, IntArray]:
    """Return a triangular lattice of a quarter of a disc.

    Ring i = 0 .. rings holds `sectors` * i + 1 nodes over the quarter turn.

    Args:
        rings: around the centre.
        sectors: of the quarter.

    Returns:
        ring of each node (n,), share of the quarter turn (n,) in [0, 1], triangles (m, 3), counterclockwise.
    """
    ring = np.concatenate([np.full(sectors * i + 1, i) for i in range(rings + 1)])
    fraction = np.concatenate([np.arange(sectors * i + 1) / max(sectors * i, 1) for i in range(rings + 1)])
    first = np.concatenate([[0], np.cumsum(sectors * np.arange(rings + 1) + 1)])
    triangles = []
    for i in range(rings):
        for s in range(sectors):
            inner, outer = first[i] + s * i, first[i + 1] + s * (i + 1)
            triangles += [(inner + q, outer + q, outer + q + 1) for q in range(i + 1)]
            triangles += [(inner + q, outer + q + 1, inner + q + 1) for q in range(i)]
    return ring, fraction, np.array(triangles, dtype=np.int64)


def quarter_disc(radius_m: float, rings: int) -> Shape:
    """Return a quarter of a flat disc in the plane z = 0, normal +z."""
    ring, fraction, triangles = sector_lattice(rings, 2)
    angle = 0.5 * math.pi * fraction
    r = radius_m * ring / rings
    positions = np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros_like(r)], axis=1)
    return Shape(positions, triangles, on_symmetry_planes(positions, (0, 1)))


def octant_sphere(radius_m: float, rings: int) -> Shape:
    """Return an eighth of a sphere about the origin; its nodes lie on the sphere."""
    ring, fraction, triangles = sector_lattice(rings, 1)
    azimuth, polar = 0.5 * math.pi * fraction, 0.5 * math.pi * ring / rings
    positions = radius_m * np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    return Shape(positions, triangles, on_symmetry_planes(positions, (0, 1, 2)))


def quarter_square(side_m: float, columns: int) -> Shape:
    """Return the quarter 0 <= x, y <= side / 2 of a flat square, normal +z, in columns x columns squares.

    Each square is cut along the diagonal towards the corner, alternately turned, so that no direction is
    preferred.
    """
    line = np.linspace(0.0, 0.5 * side_m, columns + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    positions = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return Shape(positions, grid_triangles(columns, columns), on_symmetry_planes(positions, (0, 1)))


def panel(length_m: float, height_m: float, columns: int, rows: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) [m] and triangles of a flat rectangle along x and y, normal +z.

    Node (i, j) is i (rows + 1) + j.
    """
    x, y = np.meshgrid(
        np.linspace(0.0, length_m, columns + 1), np.linspace(0.0, height_m, rows + 1), indexing="ij"
    )
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), grid_triangles(columns, rows)


def grid_triangles(columns: int, rows: int) -> IntArray:
    """Return the triangles of a grid whose node (i, j) is i (rows + 1) + j, with alternating diagonals."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    a = i * (rows + 1) + j
    b, c, d = a + rows + 1, a + rows + 2, a + 1
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int64)


def tube(radius_m: float, length_m: float, sides: int, rows: int) -> tuple[Array, IntArray]:
    """Return positions (n, 3) and outward triangles of an open tube along z from z = 0.

    Node k of ring r is r * sides + k, at the angle 2 pi k / sides. All diagonals run the same way, so that
    every node carries the pressure of the same area: with alternating ones a film without bending stiffness
    is dented at every other node.
    """
    angle = 2.0 * math.pi * np.arange(sides) / sides
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    height = np.linspace(0.0, length_m, rows + 1)
    positions = (ring[None, :, :] + height[:, None, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    r, k = (axis.ravel() for axis in np.meshgrid(np.arange(rows), np.arange(sides), indexing="ij"))
    a, b = r * sides + k, r * sides + (k + 1) % sides
    c, d = b + sides, a + sides
    first, second = np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)
    return positions, np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int64)


def held_on_axis(sides: int, nodes: int) -> Mask:
    """Return (n, 3) bool for a tube: ring 0 stays in its plane, three components stop rigid motion."""
    held = np.zeros((nodes, 3), dtype=bool)
    held[:sides, 2] = True
    held[[0, sides // 2], 1] = True
    held[sides // 4, 0] = True
    return held
