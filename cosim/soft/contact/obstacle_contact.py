"""Contact of film points with obstacle surfaces: a force at each point, by the contact law, on its nodes.

A contact point y = sum_a w_a x_a is a fixed combination of the nodes of one triangle. For one time step the
obstacle's surface near it is replaced by its tangent plane, d = n . y - c (the nearest surface point is
updated at every step; on a curved obstacle the error within a step is (tangential displacement)^2 / (2
radius)). Its stiffness is k = (stiffness per area) x (tributary area). The anchor of its stick spring moves
with the obstacle, and follows the point once |u| exceeds `stick`, so a load below the limit is held without
creep. The last evaluation of the law in a solution is at its end: forces on bodies, work, report and
stiffness are read from it.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import BLOCKS, INDEX_TABLE, INDICES, MATRIX, VECTOR, Blocks, Matrix
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.soft.contact.contact_law import GLUED, ContactLaw, touch
from cosim.soft.contact.triangle_foot import fill_point
from cosim.soft.elements.element import Sums
from cosim.soft.linear.pattern import add_block

_NO_BLOCKS = np.zeros((0, 3, 3))


class ContactPlanes(NamedTuple):
    """Tangent planes of obstacles at a body's contact points in one step, and the contact law there.

    Args:
        nodes: (k, 3) of each contact point's triangle; unused entries have weight 0.
        weights: (k, 3).
        slots: (k, 6) indices of the node pairs in the body's sparsity pattern.
        normal: (k, 3), unit, out of the obstacle.
        offset: (k,) [m], n . y - offset is the distance.
        stiffness: (k,) [N/m].
        friction: (k,) [N], largest friction force; `GLUED`: a spring holds the point in every direction.
        anchor: (k, 3) [m], world, of the stick springs.
        widths: (2,) [m], see `ContactLaw.widths`.
        body: (k,) index of the touched body.
        shape: (k,) index of the touched shape; -1 for glue.
        key: (k,) identifies the pair of contact point and shape; first points of the film, then features.
        carrier: (k, 3) [m], world: origin of the shape, or position of the feature.
        triangle: (k,) of the film, near a feature; -1 for points of the film.
        approach: (k,) [m/s], speed of approach of body and film before the step.
        point: (k, 3) [m], world, contact points of the last evaluation; NaN before the first.
        gradient: (k, 3) [N], derivative of the energy there by the point: force on the body, world axes.
        normal_force: (k,) [N], there.
        distance: (k,) [m], from the tangent plane there, negative inside.
        tangent: (k, 3, 3) [N/m], derivative of the gradient there by the point.
    """

    nodes: Annotated[IntArray, ("k", 3), INDEX_TABLE]
    weights: Annotated[Array, ("k", 3), MATRIX]
    slots: Annotated[IntArray, ("k", 6), INDEX_TABLE]
    normal: Annotated[Array, ("k", 3), MATRIX]
    offset: Annotated[Array, ("k",), VECTOR]
    stiffness: Annotated[Array, ("k",), VECTOR]
    friction: Annotated[Array, ("k",), VECTOR]
    anchor: Annotated[Array, ("k", 3), MATRIX]
    widths: Annotated[Array, (2,), VECTOR]
    body: Annotated[IntArray, ("k",), INDICES]
    shape: Annotated[IntArray, ("k",), INDICES]
    key: Annotated[IntArray, ("k",), INDICES]
    carrier: Annotated[Array, ("k", 3), MATRIX]
    triangle: Annotated[IntArray, ("k",), INDICES]
    approach: Annotated[Array, ("k",), VECTOR]
    point: Annotated[Array, ("k", 3), MATRIX]
    gradient: Annotated[Array, ("k", 3), MATRIX]
    normal_force: Annotated[Array, ("k",), VECTOR]
    distance: Annotated[Array, ("k",), VECTOR]
    tangent: Annotated[Array, ("k", 3, 3), BLOCKS]

    @classmethod
    def empty(cls, count: int, law: ContactLaw) -> "ContactPlanes":
        """Return allocated arrays for `count` contacts by a law; glue until filled."""
        nodes, slots = np.zeros((count, 3), np.int64), np.zeros((count, 6), np.int64)
        weights, normal, anchor, carrier = np.zeros((4, count, 3))
        offset, stiffness, friction, approach = np.zeros((4, count))
        body, (shape, key, triangle) = np.zeros(count, np.int64), np.full((3, count), -1)
        return cls(
            nodes, weights, slots, normal, offset, stiffness, friction, anchor, law.widths, body, shape, key,
            carrier, triangle, approach, *_results(count),
        )  # fmt: skip

    def changed(self, **arrays: Array) -> "ContactPlanes":
        """Return the contacts with other arrays of these names, without an evaluation of the law."""
        point, gradient, normal_force, distance, tangent = _results(len(self.nodes))
        results: dict[str, Any] = {"point": point, "gradient": gradient, "tangent": tangent, **arrays}
        return self._replace(normal_force=normal_force, distance=distance, **results)

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        """Add the gradient and, on request, the Hessian at positions (n, 3) [m]; return the energy [J]."""
        blocks = sums.blocks if hessian else _NO_BLOCKS
        return float(add_contacts(positions, self, sums.gradient, blocks))

    def at(self, positions: Array) -> "ContactPlanes":
        """Return the contacts, evaluated at positions (n, 3) [m] unless the last evaluation was there."""
        evaluate(positions, self)
        return self

    def sticking(self, friction: Array) -> "ContactPlanes":
        """Return the contacts for a small motion from rest: with slack stick springs and given friction.

        Args:
            friction: (k,) [N], largest friction force.
        """
        return self.changed(anchor=self.point.copy(), friction=friction)

    @property
    def force(self) -> Array:
        """(k, 3) [N], on the film, world axes, at the last evaluation."""
        return -self.gradient

    @property
    def glued(self) -> Mask:
        """(k,), which contacts are glued."""
        return np.asarray(self.friction == GLUED)

    @property
    def pressing(self) -> int:
        """Number of points that press."""
        return int((self.normal_force > 0.0).sum())

    @property
    def depth_m(self) -> float:
        """Depth of the deepest pressing point [m]; 0 if none presses, negative before penetration."""
        pressing = self.normal_force > 0.0
        return -float(self.distance[pressing].min()) if pressing.any() else 0.0


def _results(count: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return allocated arrays for results of the law at `count` points, with points NaN."""
    normal_force, distance = np.zeros((2, count))
    return np.full((count, 3), np.nan), np.zeros((count, 3)), normal_force, distance, np.zeros((count, 3, 3))


@device_function
def _evaluate(planes: ContactPlanes, e: int) -> float:
    """Evaluate the law of a contact at its point; return the energy [J]."""
    energy, planes.normal_force[e], planes.distance[e] = touch(
        planes.point[e], planes.normal[e], planes.offset[e], planes.stiffness[e], planes.friction[e],
        planes.anchor[e], planes.widths, planes.gradient[e], planes.tangent[e],
    )  # fmt: skip
    return energy


@device_function
def evaluate_again(x: Matrix, planes: ContactPlanes, e: int) -> bool:
    """Evaluate the law of a contact at nodes x (n, 3) [m]; return False if its last evaluation was there."""
    y, point = small_vector(3), planes.point[e]
    fill_point(x, planes.nodes[e], planes.weights[e], y)
    if point[0] == y[0] and point[1] == y[1] and point[2] == y[2]:
        return False
    for r in range(3):
        point[r] = y[r]
    _evaluate(planes, e)
    return True


@kernel
def evaluate(x: Matrix, planes: ContactPlanes) -> int:
    """Evaluate the law of all contacts at nodes x (n, 3) [m]; return the number of new evaluations."""
    count = 0
    for e in range(planes.nodes.shape[0]):
        count += evaluate_again(x, planes, e)
    return count


@kernel
def add_contacts(x: Matrix, planes: ContactPlanes, gradient: Matrix, blocks: Blocks) -> float:
    """Add gradient (and Hessian, if there are blocks) of contacts; return the energy [J].

    Args:
        x: (n, 3) [m], of the nodes.
        planes: k contacts, whose results are overwritten.
        gradient: (n, 3) [N], added to.
        blocks: (b, 3, 3) [N/m], added to; (0, 3, 3) for the gradient alone.
    """
    k, nodes, weights, energy = small_matrix(3, 3), planes.nodes, planes.weights, 0.0
    for e in range(nodes.shape[0]):
        fill_point(x, nodes[e], weights[e], planes.point[e])
        energy += _evaluate(planes, e)
        point_gradient, tangent = planes.gradient[e], planes.tangent[e]
        for a in range(3):
            for r in range(3):
                gradient[nodes[e, a], r] += weights[e, a] * point_gradient[r]
            if blocks.shape[0] == 0:
                continue
            for b in range(a + 1):
                product = weights[e, a] * weights[e, b]
                if product == 0.0:
                    continue
                for r in range(3):
                    for c in range(3):
                        k[r, c] = product * tangent[r, c]
                add_block(blocks, planes.slots[e, a * (a + 1) // 2 + b], k)
    return energy
