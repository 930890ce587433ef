"""Stacks of polygonal units as a source of soft bodies: the one place that turns their tables into names."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.config.schema.stack import CableTable, StackTable
from cosim.soft.geometry.holes import with_finer_holes
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.refinement import refine
from cosim.soft.geometry.surface import triangle_area

NODES_PER_AREA: Final = "nodes_per_m2"
"""Face value of a mesh refined at its holes: nodes of the drawn mesh to the square metre."""


def drawn_stack(table: StackTable) -> NamedMesh:
    """Return the unrefined mesh of a stack, in the flange's frame.

    Raises:
        MeshError: the geometry gives degenerate triangles.
    """
    t = table
    stack = PolygonalStack(
        t.sides, t.units, t.corner_radius_m, t.hole_radius_m, t.unit_height_m, t.taper,
        t.mid_ring_fraction, t.ring_heights, t.first_corner_rad,
    )  # fmt: skip
    return stack.mesh()


def stack_mesh(drawn: NamedMesh, table: StackTable) -> NamedMesh:
    """Return the mesh of a stack, refined as its table has it; the drawn one where it is not.

    Films fused at the necks are face group `holes.FUSED`.

    Raises:
        MeshError: a neck has no room, or no refinement at its hole.
    """
    if not table.refine_holes and table.neck is None:
        return refine(drawn, table.refine)
    rings = (*drawn.center_rings, drawn.tip_ring)
    drawn = replace(drawn, face_values={**drawn.face_values, NODES_PER_AREA: _nodes_per_area(drawn)})
    fused_radius_m = None if table.neck is None else table.neck.fused_radius_m
    return refine(with_finer_holes(drawn, rings, table.refine_holes, fused_radius_m), table.refine)


def _nodes_per_area(mesh: NamedMesh) -> Array:
    """Return how many nodes lie on a square metre of each triangle (m,), each spread over those around it."""
    area = np.repeat(triangle_area(mesh.positions, mesh.triangles), 3)
    around = np.bincount(mesh.triangles.ravel(), area, len(mesh.positions))
    return np.asarray((1.0 / around[mesh.triangles]).sum(axis=1))


def cable_route(mesh: NamedMesh, table: CableTable) -> IntArray:
    """Return the nodes of a mesh that a cable leads through, base to tip."""
    if table.units is None:
        return mesh.line(table.line or "")
    first, last = table.units
    return mesh.line(f"corner_{table.corner}")[first - 1 : last]
