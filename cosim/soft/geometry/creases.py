"""Creases of flat sheets: the hinges on a line, and the angles at which they rest.

A file of its own: meshes know a crease as a line, whatever hinges a body makes of it.
"""

from __future__ import annotations

import numpy as np

from cosim.base.drawing import SAME_PLACE_M
from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.geometry.named_mesh import Crease, NamedMesh
from cosim.soft.geometry.surface import dihedral_angle


def rest_angles(mesh: NamedMesh, hinges: IntArray) -> Array | None:
    """Return the angles at which hinges rest: pi - turn on a crease whose ridge is outside, else as drawn.

    Args:
        mesh: flat, with its creases.
        hinges: (h, 4), see `interior_hinges`.

    Returns:
        (h,) [rad]; None: the mesh has no creases.
    """
    if not mesh.creases:
        return None
    rest, n = dihedral_angle(mesh.positions, hinges), len(mesh.positions)
    corners = {}
    for sheet in mesh.sheets:  # each directed edge with the corner that faces it
        a, b, c = mesh.triangles[mesh.face_groups[sheet]].T
        corners[sheet] = np.concatenate(
            [(p * n + q) * n + r for p, q, r in ((a, b, c), (b, c, a), (c, a, b))]
        )
    _, j, k, far = hinges.T
    for crease in mesh.creases:
        on_line = _on(crease, mesh.positions)
        folded = on_line[j] & on_line[k]
        for sheet, own in corners.items():
            outward = np.isin((j * n + k) * n + far, own)
            inward = np.isin((k * n + j) * n + far, own)  # of another sheet, welded flat to this one
            if crease.sheet is None:
                rest[folded & outward & ~_welded(hinges, corners, n)] -= crease.turn_rad
            elif crease.sheet == sheet:
                rest[folded & outward] -= crease.turn_rad
                rest[folded & inward] += crease.turn_rad
    return rest


def _welded(hinges: IntArray, corners: dict[str, IntArray], n: int) -> Mask:
    """Return which hinges (h,) lie where two sheets are one."""
    _, j, k, far = hinges.T
    every = np.concatenate(list(corners.values()))
    return np.isin((j * n + k) * n + far, every) & np.isin((k * n + j) * n + far, every)


def _on(crease: Crease, positions: Array) -> Mask:
    """Return which nodes (n,) lie on a crease's line."""
    found = np.zeros(len(positions), dtype=bool)
    for a, b in zip(crease.points[:-1], crease.points[1:], strict=True):
        along = np.clip((positions - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        found |= np.linalg.norm(positions - a - along[:, None] * (b - a), axis=1) < SAME_PLACE_M
    return found
