"""Finer meshes around the hole rings of a stack, where its units bend, and films fused there.

Around a small hole the film's displacements go with the logarithm of the distance from the axis: nodes are
put at a third of the logarithmic way outwards, not at the midpoint. Measured: docs/necks.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.refinement import refine_some

FUSED: Final = "fused"
"""Face group of the triangles whose two films are fused."""
_ROUNDING: Final = 1e-9
_LOGARITHMIC_WAY: Final = 1.0 / 3.0
_NONE: Final = np.zeros(0, np.int64)


def with_finer_holes(
    mesh: NamedMesh, holes: Sequence[str], levels: int, fused_radius_m: float | None = None
) -> NamedMesh:
    """Return the mesh with all edges cut that end at hole rings, `levels` times.

    Where films are fused, the first cuts are at that radius, the next those of all edges that end at fused
    triangles. Triangles within the radius are in face group FUSED.

    Args:
        mesh: the coarse mesh, the z axis through its holes.
        holes: names of the rings.
        levels: >= 0, with fused films >= 1.
        fused_radius_m: from the axis, beyond the hole rings and within all other nodes; None: none are fused.

    Raises:
        MeshError: a hole ring reaches beyond the radius, another node is within it, or no level puts nodes
            there.
    """
    if fused_radius_m is not None:
        _check_fused(mesh, holes, levels, fused_radius_m)
    for level in range(levels):
        core = np.zeros(len(mesh.positions), dtype=bool)
        core[np.concatenate([mesh.ring(name) for name in holes])] = True
        core[mesh.triangles[mesh.face_groups.get(FUSED, _NONE)]] = True
        if level == 0 and fused_radius_m is not None:
            mesh = _with_groups(_cut_around(mesh, core, fused_radius_m), fused_radius_m)
        else:
            mesh = _cut_around(mesh, core)
    return mesh


def _check_fused(mesh: NamedMesh, holes: Sequence[str], levels: int, fused_radius_m: float) -> None:
    if levels < 1:
        raise MeshError(f"holes are refined {levels} times; fused films need 1 or more")
    ring = np.concatenate([mesh.ring(name) for name in holes])
    distance = _from_axis(mesh)
    inner, outer = float(distance[ring].max()), float(np.delete(distance, ring).min())
    if not inner * (1.0 + _ROUNDING) < fused_radius_m < outer * (1.0 - _ROUNDING):
        raise MeshError(
            f"fused_radius_m is {fused_radius_m:g}; it must lie between {inner:.4g}, the corners of the "
            f"hole rings, and {outer:.4g}, the next node"
        )


def _with_groups(mesh: NamedMesh, fused_radius_m: float) -> NamedMesh:
    fused = (_from_axis(mesh) <= fused_radius_m * (1.0 + _ROUNDING))[mesh.triangles].all(axis=1)
    return replace(mesh, face_groups={**mesh.face_groups, FUSED: np.flatnonzero(fused)})


def _from_axis(mesh: NamedMesh) -> Array:
    return np.hypot(mesh.positions[:, 0], mesh.positions[:, 1])


def _cut_around(mesh: NamedMesh, core: Mask, radius_m: float | None = None) -> NamedMesh:
    """Return the mesh with all edges cut that end at core nodes (n,).

    Those with both ends there are cut midway, those that leave at a distance from the axis: the given one, or
    a part of the logarithmic way to their other end.
    """

    def touching(edges: IntArray) -> Mask:
        return np.asarray(core[edges].any(axis=1))

    def fractions(edges: IntArray) -> Array:
        found = np.full(len(edges), 0.5)
        leaving = np.flatnonzero(core[edges].sum(axis=1) == 1)
        outwards = core[edges[leaving, 0]]
        ordered = np.where(outwards[:, None], edges[leaving], edges[leaving, ::-1])
        near, far = (mesh.positions[ordered[:, k], :2] for k in range(2))
        start, end = np.linalg.norm(near, axis=1), np.linalg.norm(far, axis=1)
        wanted = (
            start * (end / start) ** _LOGARITHMIC_WAY if radius_m is None else np.full(len(start), radius_m)
        )
        place = _crossing(near, far, wanted)
        found[leaving] = np.where(outwards, place, 1.0 - place)
        return found

    return refine_some(mesh, touching, fractions)


def _crossing(near: Array, far: Array, radius: Array) -> Array:
    """Return the fraction (k,) of the way from points (k, 2) to others at which |point| is a radius (k,)."""
    way = far - near
    # |near + t way| = radius: a t^2 + 2 b t + c = 0, c < 0
    a, b = np.einsum("kr,kr->k", way, way), np.einsum("kr,kr->k", near, way)
    c = np.einsum("kr,kr->k", near, near) - radius**2
    return np.asarray((np.sqrt(b * b - a * c) - b) / a)
