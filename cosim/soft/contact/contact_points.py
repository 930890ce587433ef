"""Contact points of a film: nodes, edge midpoints and centroids, each with a tributary area.

The areas are those of the rule that integrates cubics over a triangle: 1/20 of its area at each corner, 2/15
at each edge midpoint, 9/20 at the centroid. So the contact pressure of a film on an obstacle converges with
the mesh. Source: Abramowitz and Stegun, Handbook of Mathematical Functions, table 25.4.62.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import kernel
from cosim.base.state_checks import check_indices
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import obstacle_contact
from cosim.soft.geometry.surface import directed_edges, triangle_area
from cosim.soft.linear.pattern import BlockPattern

_CORNER, _MIDPOINT, _CENTROID = 1.0 / 20.0, 2.0 / 15.0, 9.0 / 20.0


@kernel
def _combine(x: Matrix, nodes: IndexTable, weights: Matrix, chosen: Indices, out: Matrix) -> None:
    """Fill out[k] = sum_a weights[k, a] x[nodes[k, a]] for chosen k."""
    for k in chosen:
        for r in range(3):
            out[k, r] = (
                weights[k, 0] * x[nodes[k, 0], r]
                + weights[k, 1] * x[nodes[k, 1], r]
                + weights[k, 2] * x[nodes[k, 2], r]
            )


@kernel
def _span(x: Matrix, v: Matrix, low: Vector, high: Vector) -> float:
    """Fill smallest and largest coordinates of x; return the largest |v|."""
    low[:], high[:], fastest = np.inf, -np.inf, 0.0
    for n in range(x.shape[0]):
        square = 0.0
        for r in range(3):
            low[r] = min(low[r], x[n, r])
            high[r] = max(high[r], x[n, r])
            square += v[n, r] * v[n, r]
        fastest = max(fastest, square)
    return np.sqrt(fastest)


@final
@dataclass(frozen=True)
class Extent:
    """Bounds of a body.

    Args:
        low: (3,) [m], smallest coordinates.
        high: (3,) [m], largest coordinates.
        speed_m_s: of the fastest node.
    """

    low: Array
    high: Array
    speed_m_s: float

    @classmethod
    def of(cls, positions: Array, velocities: Array) -> "Extent":
        """Return the bounds of nodes at positions (n, 3) [m] with velocities (n, 3) [m/s]."""
        low, high = np.empty(3), np.empty(3)
        return cls(low, high, _span(positions, velocities, low, high))


@final
@dataclass(frozen=True)
class ContactSurface:
    """Contact points of a body: nodes, then edge midpoints, then centroids.

    Args:
        nodes: (p, 3), nodes of each point's triangle.
        weights: (p, 3), barycentric.
        slots: (p, 6) indices of the node pairs in the sparsity pattern.
        area: (p,) [m^2], tributary area.
        triangles: (m, 3).
        triangle_slots: (m, 6).
    """

    nodes: IntArray
    weights: Array
    slots: IntArray
    area: Array
    triangles: IntArray
    triangle_slots: IntArray

    @classmethod
    def of(cls, body: SoftBody, pattern: BlockPattern) -> "ContactSurface":
        """Return the contact surface of a body's film.

        Args:
            body: its drawn shape gives the areas.
            pattern: of the body's tangent.
        """
        triangles = body.triangles
        areas = triangle_area(body.positions, triangles)
        used = np.unique(triangles)
        edges, edge = np.unique(np.sort(directed_edges(triangles), axis=1), axis=0, return_inverse=True)
        nodes = np.concatenate(
            [np.repeat(used[:, None], 3, axis=1), np.column_stack([edges, edges[:, 0]]), triangles]
        )
        weights = np.repeat(
            [[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1.0 / 3.0] * 3],
            [len(used), len(edges), len(triangles)],
            axis=0,
        )
        at_nodes = np.bincount(triangles.ravel(), np.repeat(areas, 3), len(body.positions))[used]
        at_edges = np.bincount(edge.ravel(), np.repeat(areas, 3), len(edges))
        area = np.concatenate([_CORNER * at_nodes, _MIDPOINT * at_edges, _CENTROID * areas])
        nodes = np.ascontiguousarray(nodes)
        return cls(
            nodes,
            np.ascontiguousarray(weights),
            pattern.slots(nodes),
            area,
            triangles,
            pattern.slots(triangles),
        )

    def check_planes(self, planes: obstacle_contact.ContactPlanes) -> None:
        """Check that saved contacts have nodes and node pairs of this surface.

        Raises:
            InputError: one has not.
        """
        check_indices(planes.nodes, int(self.nodes.max()) + 1, "nodes")
        pairs = int(max(_pair(self.slots).max(), _pair(self.triangle_slots).max())) + 1
        check_indices(_pair(planes.slots), pairs, "node pairs")

    def __len__(self) -> int:
        return len(self.nodes)

    def points(self, positions: Array) -> Array:
        """Return the contact points (p, 3) [m] at node positions (n, 3) [m]."""
        out = np.empty((len(self), 3))
        self.fill_points(positions, np.arange(len(self)), out)
        return out

    def fill_points(self, positions: Array, chosen: IntArray, out: Array) -> None:
        """Fill the chosen (k,) of the contact points (p, 3) [m] at node positions (n, 3) [m]."""
        _combine(positions, self.nodes, self.weights, chosen, out)


def _pair(slots: IntArray) -> IntArray:
    """Return the indices of node pairs in the pattern, for either order of the two nodes."""
    return np.where(slots < 0, ~slots, slots)
