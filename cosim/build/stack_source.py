"""Stacks of polygonal units as a source of soft bodies: the one place that turns their tables into names."""

from __future__ import annotations

from cosim.base.frames import IntArray
from cosim.config.schema.stack import CableTable, StackTable
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.polygonal_stack import PolygonalStack


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


def cable_route(mesh: NamedMesh, table: CableTable) -> IntArray:
    """Return the nodes of a mesh that a cable leads through, base to tip."""
    if table.units is None:
        return mesh.line(table.line or "")
    first, last = table.units
    return mesh.line(f"corner_{table.corner}")[first - 1 : last]
