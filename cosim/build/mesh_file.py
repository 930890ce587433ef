"""Builds the film of a mesh file: its triangles, caps that close its open ends, and its named sets
of nodes.
"""

from pathlib import Path

import numpy as np

from cosim.base import triangle_mesh
from cosim.base.frames import Array, IntArray, cross, in_mm
from cosim.config.schema import body_sources
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.surface import check_mesh, directed_edges, nodes_of_several_fans, rims

_SAME_PLANE = 1e-5  # of the film's size


def drawn_mesh(table: body_sources.MeshTable) -> NamedMesh:
    """Return the film of a mesh file, in the flange's frame.

    Raises:
        MeshError: the file cannot be read, its surface is not sound, or a set has no nodes.
    """
    read = triangle_mesh.read_surface(Path(table.file))
    surface = triangle_mesh.GroupedSurface(table.scale * read.vertices, read.triangles, read.groups)
    check_mesh(surface.vertices, surface.triangles)
    pinched = nodes_of_several_fans(surface.triangles)
    if len(pinched):
        raise MeshError(
            f"{Path(table.file).name}: two parts of the film touch only in node {pinched[0]} at "
            f"{in_mm(surface.vertices[pinched[0]])}: their gas would be one; move them apart, or join "
            "them along edges"
        )
    holes = rims(surface.triangles)
    if _six_volumes(surface, holes) < 0.0:
        raise MeshError(f"{Path(table.file).name}: is inside out; turn its triangles over")
    sets = {entry.name: _nodes(entry, surface) for entry in table.sets}
    for name, nodes in sets.items():
        rim = next((hole for hole in holes if set(hole.tolist()) == set(nodes.tolist())), None)
        sets[name] = nodes if rim is None else rim
    return NamedMesh(
        positions=surface.vertices,
        triangles=surface.triangles,
        rings=sets,
        caps=holes,
        base_ring=table.sets[0].name,
        tip_ring=table.tip,
        lines=sets,
        face_groups=surface.groups,
    )


def _six_volumes(surface: triangle_mesh.GroupedSurface, holes: tuple[IntArray, ...]) -> float:
    """Return six times the volume [m^3] that film and caps enclose, see `cosim.soft.elements.pressure`."""
    x = surface.vertices - surface.vertices.mean(axis=0)
    a, b, c = (x[surface.triangles[:, k]] for k in range(3))
    caps = (x[hole].mean(axis=0) @ cross(x[hole], x[np.roll(hole, -1)]).sum(axis=0) for hole in holes)
    return float((a * cross(b, c)).sum() + sum(caps))


def _nodes(entry: body_sources.NodeSetTable, surface: triangle_mesh.GroupedSurface) -> IntArray:
    if entry.group is not None:
        if entry.group not in surface.groups:
            known = ", ".join(surface.groups) or "none"
            raise MeshError(f"set {entry.name!r} is of group {entry.group!r}; the file has: {known}")
        return np.unique(surface.triangles[surface.groups[entry.group]])
    if entry.axis is not None and entry.at_m is not None:
        return _in_plane(entry.name, "xyz".index(entry.axis), entry.at_m, surface.vertices)
    return _nearest(entry.name, np.array(entry.points_m), surface)


def _in_plane(name: str, axis: int, at_m: float, x: Array) -> IntArray:
    """Return the nodes in a plane across an axis, around it counter-clockwise seen from outside."""
    low, high = float(x[:, axis].min()), float(x[:, axis].max())
    found = np.flatnonzero(np.abs(x[:, axis] - at_m) <= _SAME_PLANE * float(np.ptp(x, axis=0).max()))
    if not found.size:
        raise MeshError(
            f"set {name!r} is at {'xyz'[axis]} = {at_m:g} m, where no node is; the film reaches from "
            f"{low:g} m to {high:g} m"
        )
    offset = x[found] - x[found].mean(axis=0)
    angle = np.arctan2(offset[:, (axis + 2) % 3], offset[:, (axis + 1) % 3])
    return found[np.argsort(angle if at_m > 0.5 * (low + high) else -angle, kind="stable")]


def _nearest(name: str, points: Array, surface: triangle_mesh.GroupedSurface) -> IntArray:
    x = surface.vertices
    ends = x[directed_edges(surface.triangles)]
    reach = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
    found = np.empty(len(points), np.int64)
    for k, point in enumerate(points):
        distance = np.linalg.norm(x - point, axis=1)
        found[k] = np.argmin(distance)
        if distance[found[k]] > reach:
            raise MeshError(
                f"set {name!r}: point {point.tolist()} is {distance[found[k]]:.3g} m from the nearest node, "
                f"further than the longest edge, {reach:.3g} m"
            )
    return found
