"""Builds the mesh of a stack of polygonal units from its table: drawn, with finer holes, fused necks, or
graded.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.stack import StackTable
from cosim.soft.geometry.named_mesh import NamedMesh, refine
from cosim.soft.geometry.polygonal_stack import PolygonalStack, with_finer_holes
from cosim.soft.geometry.surface import triangle_area

NODES_PER_AREA: Final = "nodes_per_m2"
"""Face value of a mesh with additional nodes at its holes: nodes of the drawn mesh per square metre."""


def drawn_stack(table: StackTable) -> NamedMesh:
    """Return the unrefined mesh of a stack, in the flange's frame.

    Raises:
        MeshError: the geometry gives degenerate triangles.
    """
    return _stack(table).mesh()


def _stack(table: StackTable) -> PolygonalStack:
    t = table
    return PolygonalStack(
        t.sides, t.units, t.corner_radius_m, t.hole_radius_m, t.unit_height_m, t.taper,
        t.mid_ring_fraction, t.ring_heights, t.first_corner_rad,
    )  # fmt: skip


def stack_mesh(drawn: NamedMesh, table: StackTable) -> NamedMesh:
    """Return the mesh of a stack with the refinements of its table.

    Films fused at the necks are the face group `FUSED`.

    Args:
        drawn: unrefined mesh of the stack.
        table: of the stack.

    Raises:
        MeshError: a neck has no room, or no refinement at its hole.
    """
    fused_radius_m = None if table.neck is None else table.neck.fused_radius_m
    if table.mesh == "graded":
        return refine(
            _spread_by_unit(_stack(table).graded_mesh(fused_radius_m), drawn, table.units), table.refine
        )
    if not table.refine_holes and table.neck is None:
        return refine(drawn, table.refine)
    rings = (*drawn.center_rings, drawn.tip_ring)
    drawn = replace(drawn, face_values={**drawn.face_values, NODES_PER_AREA: _nodes_per_area(drawn)})
    return refine(with_finer_holes(drawn, rings, table.refine_holes, fused_radius_m), table.refine)


def _spread_by_unit(mesh: NamedMesh, drawn: NamedMesh, units: int) -> NamedMesh:
    """Return a mesh with the face value `NODES_PER_AREA`: the drawn nodes of each unit, spread over its film.

    The rings of the drawn mesh have equal distances and equal numbers of nodes, so the nodes per area are
    proportional to 1 / (distance from the axis).
    """
    area, spread_over = (
        triangle_area(film.positions, film.triangles).reshape(units, -1) for film in (drawn, mesh)
    )
    nodes = (area * _nodes_per_area(drawn).reshape(units, -1)).sum(axis=1)
    radius = np.linalg.norm(mesh.positions[mesh.triangles].mean(axis=1)[:, :2], axis=1).reshape(units, -1)
    spread = (nodes / (spread_over / radius).sum(axis=1))[:, None] / radius
    return replace(mesh, face_values={**mesh.face_values, NODES_PER_AREA: spread.ravel()})


def _nodes_per_area(mesh: NamedMesh) -> Array:
    """Return the nodes per square metre of each triangle (m,), spread evenly around each node."""
    area = np.repeat(triangle_area(mesh.positions, mesh.triangles), 3)
    around = np.bincount(mesh.triangles.ravel(), area, len(mesh.positions))
    return np.asarray((1.0 / around[mesh.triangles]).sum(axis=1))


@lru_cache(maxsize=2)
def stack_meshes(table: StackTable) -> tuple[NamedMesh, NamedMesh]:
    """Return the drawn and the refined mesh of a stack; cached for derivatives, which build many bodies."""
    drawn = drawn_stack(table)
    return drawn, stack_mesh(drawn, table)
