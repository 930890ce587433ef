"""Stiffness of hinges with which they bend like a shell of flexural rigidity D = E t^3 / (12 (1 - nu^2)).

Bend a flat triangulated sheet to a cylinder of small curvature kappa along the unit direction n in its plane.
At the hinge of two triangles, with p and q from the edge's nodes to a triangle's far corner,
    theta - pi = kappa (b_i + b_l),   b = (n . p) (n . q) / (2 h),   h the height over the edge.
A hinge stands for the area a around its edge: a third of each triangle, more where a triangle has edges
without hinge. The rule asks that, averaged over all n, it stores that area's energy:
    k <(b_i + b_l)^2> / 2 = D a / 2,   <(n . M n)^2> = ((tr M)^2 + 2 tr M^2) / 8 for symmetric M.
For equilateral triangles this is k = D L^2 / (A_i + A_l) = 2 D / sqrt(3), and exact in every direction.
Hinges cannot be isotropic on other triangles: the mean is exact, single directions are off (right-angled
triangles with parallel diagonals: 0.5 to 2, alternating ones: 7/8 to 9/8, the chambers here: 0.92 to 1.08).
k does not depend on the size of the triangles.
Source: form of the energy: Grinspun et al., Discrete shells, SCA 2003; equilateral triangles: Seung and
Nelson, Phys. Rev. A 38 (1988) 1005; the rule by area and mean direction is derived here.
"""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.surface import directed_edges, triangle_area


def _angle_forms(positions: Array, hinges: IntArray) -> Array:
    """Return M (h, 2, 2) [m]: theta - pi = kappa n . M n, axes along the edge and across it, unfolded."""
    xi, xj, xk, xl = (positions[hinges[:, a]] for a in range(4))
    edge = xk - xj
    length = np.linalg.norm(edge, axis=1)
    along = edge / length[:, None]
    total = np.zeros((len(hinges), 2, 2))
    # unfolded, the second triangle lies on the other side of the edge
    for corner, side in ((xi, 1.0), (xl, -1.0)):
        s = np.einsum("hr,hr->h", corner - xj, along)
        height = np.linalg.norm(corner - xj - s[:, None] * along, axis=1)
        p = np.stack([s, side * height], axis=1)
        q = np.stack([s - length, side * height], axis=1)
        product = np.einsum("ha,hb->hab", p, q)
        total += (product + product.transpose(0, 2, 1)) / (4.0 * height)[:, None, None]
    return total


def mean_square_angle(positions: Array, hinges: IntArray) -> Array:
    """Return <(theta - pi)^2> / kappa^2 (h,) [m^2] of each hinge over all directions of a cylinder.

    Args:
        positions: (n, 3) [m], drawn shape; it need not be flat, each pair of triangles is unfolded.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
    """
    form = _angle_forms(positions, hinges)
    trace = np.trace(form, axis1=1, axis2=2)
    return np.asarray((trace**2 + 2.0 * np.einsum("hab,hab->h", form, form)) / 8.0)


def hinge_areas(positions: Array, triangles: IntArray, hinges: IntArray) -> Array:
    """Return the area (h,) [m^2] that each hinge stands for; each triangle is shared out among its hinges.

    Args:
        positions: (n, 3) [m], drawn shape.
        triangles: (m, 3).
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.

    Raises:
        MeshError: a hinge lies on no edge of the triangles.
    """
    areas = np.zeros(len(hinges))
    if not len(hinges):
        return areas
    number = np.array([len(positions), 1])
    keys = np.sort(hinges[:, 1:3], axis=1) @ number
    order = np.argsort(keys)
    edges = np.sort(directed_edges(triangles), axis=1) @ number
    hinge = order[np.minimum(np.searchsorted(keys[order], edges), len(order) - 1)]
    carried = keys[hinge] == edges
    share = triangle_area(positions, triangles) / np.maximum(carried.reshape(-1, 3).sum(axis=1), 1)
    np.add.at(areas, hinge[carried], np.repeat(share, 3)[carried])
    stray = np.flatnonzero(areas == 0.0)
    if stray.size:
        edge = hinges[stray[0], 1:3].tolist()
        raise MeshError(f"hinge {stray[0]} (edge {edge}) lies on no edge of the triangles")
    return areas


def shell_stiffness(
    positions: Array, triangles: IntArray, hinges: IntArray, rigidity_Nm: Array | float
) -> Array:
    """Return the stiffness (h,) [N m/rad] with which the hinges bend like a shell.

    k = D a / <(theta - pi)^2 / kappa^2>, see the module's text.

    Args:
        positions: (n, 3) [m], drawn shape.
        triangles: (m, 3).
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
        rigidity_Nm: (h,) or one number, D [N m].

    Raises:
        MeshError: a hinge lies on no edge of the triangles.
    """
    return rigidity_Nm * hinge_areas(positions, triangles, hinges) / mean_square_angle(positions, hinges)


def bending_measure(positions: Array, hinges: IntArray, stiffness: Array | float = 1.0) -> float:
    """Return sum k <(theta - pi)^2> / kappa^2 [N m^3], twice the mean cylinder bending energy over kappa^2.

    For a shell it is D times the area. A uniform stiffness keeps it over refinement when it is scaled by
    the ratio of the measures, near 1: a finer mesh has hinges along seams that the coarse one lacks.

    Args:
        positions: (n, 3) [m], drawn shape.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
        stiffness: (h,) or one number [N m/rad].
    """
    return float(np.sum(stiffness * mean_square_angle(positions, hinges)))
