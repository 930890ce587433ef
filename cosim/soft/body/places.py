"""Places on a soft body: its centre line, the frame of its tip, and descriptions of nodes for messages."""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import kernel, small_vector
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody

_SAME_PLACE_M = 1e-9


def center_rings(body: SoftBody) -> IntArray:
    """Return the rings (rings, nodes per ring) along the centre, base to tip; those of the first copy.

    They are the body's `center_rings`, or if it has none the ring "base", and the tip. Nodes of smaller rings
    are repeated, which does not change their centre.
    """
    before_tip = [body.rings[name] for name in body.center_rings] or [body.before_tip]
    rings = [ring for ring in (*before_tip, body.tip) if len(ring)]
    nodes = math.lcm(*(len(ring) for ring in rings))
    return np.stack([np.tile(ring, nodes // len(ring)) for ring in rings])


def center_line_length(rings: IntArray, positions: Array) -> float:
    """Return the length [m] of the polyline through the rings' centres.

    Args:
        rings: (rings, nodes per ring), base to tip.
        positions: (n, 3) [m].
    """
    steps = np.diff(positions[rings].mean(axis=1), axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


@kernel
def ring_figures(points: Blocks, nodes: int, center: Matrix, normal: Matrix, length: Vector) -> None:
    """Fill center, normal (k, 3) and length (k,) of k shapes from points (k, n, 3).

    The first `nodes` points are the tip ring in order, sum_i (r_i - r_0) x (r_i+1 - r_0) its normal; the
    others are the polyline.
    """
    area, arm, next_arm = small_vector(3), small_vector(3), small_vector(3)
    for k in range(points.shape[0]):
        area[:] = 0.0
        for i in range(1, nodes - 1):
            for r in range(3):
                arm[r] = points[k, i, r] - points[k, 0, r]
                next_arm[r] = points[k, i + 1, r] - points[k, 0, r]
            for r in range(3):
                s, t = (r + 1) % 3, (r + 2) % 3
                area[r] += arm[s] * next_arm[t] - arm[t] * next_arm[s]
        size = np.sqrt(area[0] * area[0] + area[1] * area[1] + area[2] * area[2])
        for r in range(3):
            normal[k, r] = area[r] / size if size > 0.0 else 0.0
            total = 0.0
            for i in range(nodes):
                total += points[k, i, r]
            center[k, r] = total / nodes
        length[k] = 0.0
        for i in range(nodes + 1, points.shape[1]):
            square = 0.0
            for r in range(3):
                step = points[k, i, r] - points[k, i - 1, r]
                square += step * step
            length[k] += np.sqrt(square)


@final
@dataclass(frozen=True)
class TipFrame:
    """Position, direction and frame of the tip ring, and their motion with the nodes.

    Args:
        position: (3,) [m], mean of the ring.
        rotation: (3, 3); the last column is the ring's unit normal, the first points to its first node.
    """

    position: Array
    rotation: Array

    @classmethod
    def of(cls, body: SoftBody, positions: Array) -> "TipFrame":
        """Return the tip frame at the given node positions (n, 3) [m]."""
        center = body.tip_position(positions)
        z = body.tip_direction(positions)
        x = positions[body.tip[0]] - center
        x = x - (x @ z) * z
        x = x / np.linalg.norm(x)
        return cls(center, np.stack([x, np.cross(z, x), z], axis=1))

    @property
    def direction(self) -> Array:
        """(3,), unit normal of the ring, away from the base."""
        return np.asarray(self.rotation[:, 2])

    def motion(self, body: SoftBody, positions: Array, displacement: Array) -> Array:
        """Return the tip's (6,) displacement [m] and rotation [rad] under a nodal displacement.

        Args:
            body: with the tip.
            positions: (n, 3) [m].
            displacement: (n, 3) [m], infinitesimal.
        """
        ring, moved = positions[body.tip], displacement[body.tip]
        shift = moved.mean(axis=0)
        x, _, z = self.rotation.T
        if body.tip_is_line:
            nodes, weights = body.tip_way
            area, d_area = weights @ positions[nodes], weights @ displacement[nodes]
        else:
            area = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
            d_area = (
                np.cross(moved, np.roll(ring, -1, axis=0)) + np.cross(ring, np.roll(moved, -1, axis=0))
            ).sum(0)
        dz = (d_area - (d_area @ z) * z) / np.linalg.norm(area)
        arm, d_arm = ring[0] - self.position, moved[0] - shift
        flat = arm - (arm @ z) * z
        d_flat = d_arm - (d_arm @ z + arm @ dz) * z - (arm @ z) * dz
        dx = (d_flat - (d_flat @ x) * x) / np.linalg.norm(flat)
        # the rotation w has w x z = dz and (w x x) . (z x x) = w . z
        spin = float(dx @ np.cross(z, x))
        return np.concatenate([shift, np.cross(z, dz) + spin * z])


def describe_largest(body: SoftBody, positions: Array, gradient: Array, free: Mask) -> str:
    """Return the description of the node with the largest residual, see `describe_node`.

    Args:
        body: of the residual.
        positions: (n, 3) [m].
        gradient: (n, 3) [N], of the potential there.
        free: (n, 3) bool, components that move.
    """
    size = np.where(free, np.abs(gradient), 0.0).max(axis=1)
    return describe_node(body, positions, int(np.argmax(np.where(np.isfinite(size), size, np.inf))))


def describe_node(body: SoftBody, positions: Array, node: int) -> str:
    """Return the description of a node: its number, and its ring or the nearest one.

    Args:
        body: of the node.
        positions: (n, 3) [m].
        node: its number.
    """
    if not body.rings:
        return f"node {node}"
    of_node = [name for name, nodes in body.rings.items() if node in nodes]
    if of_node:
        return f"node {node} of {of_node[0]}"
    distances = {
        name: np.linalg.norm(positions[nodes] - positions[node], axis=1).min()
        for name, nodes in body.rings.items()
    }
    return f"node {node} near {min(distances, key=lambda name: float(distances[name]))}"


def parents(coarse: SoftBody, fine: SoftBody) -> IntArray:
    """Return the two parent nodes (n, 2) of each node of a refined mesh, which lies halfway between them.

    The parts of a triangle a, b, c lie next to one another: (a, ab, ca), (ab, b, bc), (ca, bc, c) and the
    middle one; see `cosim.soft.geometry.named_mesh`.

    Args:
        coarse: the body.
        fine: the same with every triangle divided into four.

    Raises:
        MeshError: the meshes are not so related.
    """
    parent_nodes = np.full((fine.nodes, 2), -1)
    if len(fine.triangles) == 4 * len(coarse.triangles):
        a, b, c = coarse.triangles.T
        children = fine.triangles.reshape(-1, 4, 3)
        ends = ((0, 0, a, a), (1, 1, b, b), (2, 2, c, c), (0, 1, a, b), (1, 2, b, c), (2, 0, c, a))
        for child, corner, first, second in ends:
            parent_nodes[children[:, child, corner]] = np.stack([first, second], axis=1)
    offset = fine.positions - coarse.positions[parent_nodes].mean(axis=1)
    if (parent_nodes < 0).any() or float(np.abs(offset).max()) > _SAME_PLACE_M:
        raise MeshError("the mesh is not the other one with every triangle divided into four")
    return parent_nodes
