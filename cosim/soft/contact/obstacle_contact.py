"""Contact of film points with obstacle surfaces: a force at each point, by the contact law, on its nodes.

A contact point y = sum_a w_a x_a is a fixed combination of the nodes of one triangle. For one time step the
obstacle's surface near it is its tangent plane, d = n . y - c (the nearest surface point of a curved obstacle
is found again at every step; the error within a step is (tangential displacement)^2 / (2 radius)). Its
stiffness is k = (stiffness per area) x (tributary area). The anchor of its stick spring rides on the obstacle
and is dragged along once |u| exceeds `stick`, so a load below the limit is held without creep.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import kernel, small_matrix, small_vector
from cosim.soft.contact.contact_law import GLUED, ContactLaw, touch
from cosim.soft.elements.element import Sums
from cosim.soft.linear.pattern import add_block

_NO_BLOCKS = np.zeros((0, 3, 3))


class PlaneRows(NamedTuple):
    """The arrays of `ContactPlanes`, for kernels."""

    nodes: IndexTable
    weights: Matrix
    slots: IndexTable
    normal: Matrix
    offset: Vector
    stiffness: Vector
    friction: Vector
    anchor: Matrix
    body: Indices

    @classmethod
    def room(cls, count: int) -> "PlaneRows":
        """Return room for so many."""
        slots, body = np.empty((count, 6), np.int64), np.empty(count, np.int64)
        nodes, (weights, normal, anchor) = np.empty((count, 3), np.int64), np.empty((3, count, 3))
        offset, stiffness, friction = np.empty((3, count))
        return cls(nodes, weights, slots, normal, offset, stiffness, friction, anchor, body)


@kernel
def add_contacts(
    x: Matrix, planes: PlaneRows, widths: Vector, gradient: Matrix, blocks: Blocks, ends: Matrix
) -> float:
    """Add gradient (and Hessian, if there are blocks) of contacts; return the energy [J].

    Args:
        x: (n, 3) [m], of the nodes.
        planes: k contacts.
        widths: (2,) [m], of the law's transitions: across, then along the surface.
        gradient: (n, 3) [N], added to.
        blocks: (b, 3, 3) [N/m], added to; (0, 3, 3) for the gradient alone.
        ends: (k, 4) [N], filled with the gradient of each by its point, and its normal force.
    """
    point, tangent, k = small_vector(3), small_matrix(3, 3), small_matrix(3, 3)
    nodes, weights, normal, friction = planes.nodes, planes.weights, planes.normal, planes.friction
    energy = 0.0
    for e in range(nodes.shape[0]):
        for r in range(3):
            point[r] = 0.0
            for a in range(3):
                point[r] += weights[e, a] * x[nodes[e, a], r]
        own = ends[e]
        level, own[3] = touch(
            point, normal[e], planes.offset[e], planes.stiffness[e], friction[e], planes.anchor[e], widths[0],
            widths[1], own, tangent,
        )  # fmt: skip
        energy += level
        for a in range(3):
            for r in range(3):
                gradient[nodes[e, a], r] += weights[e, a] * own[r]
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


@final
@dataclass(frozen=True)
class ContactPlanes:
    """What a body may touch in one step: tangent planes of obstacles at its contact points.

    Args:
        nodes: (k, 3) of each contact point's triangle; unused entries have weight 0.
        weights: (k, 3).
        slots: (k, 6) places of the node pairs in the body's sparsity pattern.
        normal: (k, 3), unit, out of the obstacle.
        offset: (k,) [m], n . y - offset is the distance.
        stiffness: (k,) [N/m].
        friction: (k,) [N], largest friction force; `GLUED`: a spring holds the point in every direction.
        anchor: (k, 3) [m], world, where the stick springs are tied.
        law: widths of the transitions.
        body: (k,) index of the touched body; empty where nobody asks for it.
    """

    nodes: Annotated[IntArray, ("k", 3)]
    weights: Annotated[Array, ("k", 3)]
    slots: Annotated[IntArray, ("k", 6)]
    normal: Annotated[Array, ("k", 3)]
    offset: Annotated[Array, ("k",)]
    stiffness: Annotated[Array, ("k",)]
    friction: Annotated[Array, ("k",)]
    anchor: Annotated[Array, ("k", 3)]
    law: ContactLaw
    body: Annotated[IntArray, ("b",)] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self.nodes)

    @classmethod
    def of(cls, rows: PlaneRows, law: ContactLaw) -> "ContactPlanes":
        """Return contacts with such arrays."""
        found = cls(*rows[:-1], law=law, body=rows.body)
        found.__dict__["rows"] = rows
        return found

    @cached_property
    def rows(self) -> PlaneRows:
        """The arrays."""
        return PlaneRows(*(getattr(self, name) for name in PlaneRows._fields))

    @cached_property
    def widths(self) -> Array:
        """(2,) [m], of the law's transitions: across, then along the surface."""
        return np.array([self.law.smoothing_m, self.law.stick_m])

    @cached_property
    def ends(self) -> Array:
        """(k, 4) [N], gradient of each by its point, and its normal force, where they were added last."""
        return np.empty((len(self), 4))

    def add(self, positions: Array, sums: Sums, hessian: bool) -> float:
        """Add the gradient and, if told to, the Hessian at positions (n, 3) [m]; return the energy [J]."""
        blocks = sums.blocks if hessian else _NO_BLOCKS
        return float(add_contacts(positions, self.rows, self.widths, sums.gradient, blocks, self.ends))

    def at(self, positions: Array) -> "ContactForces":
        """Return forces and places of the contact points at positions (n, 3) [m]."""
        ends = np.empty((len(self), 4))
        add_contacts(positions, self.rows, self.widths, np.zeros_like(positions), _NO_BLOCKS, ends)
        point = np.einsum("ka,kar->kr", self.weights, positions[self.nodes])
        distance = np.einsum("kr,kr->k", self.normal, point) - self.offset
        return ContactForces(point, -ends[:, :3], ends[:, 3].copy(), distance)

    def sticking(self, points: Array, friction: Array) -> "ContactPlanes":
        """Return the contacts as they answer a small motion from rest: stick springs slack, friction present.

        Args:
            points: (k, 3) [m], where the contact points are.
            friction: (k,) [N], largest friction force.
        """
        return replace(self, anchor=points, friction=friction)

    def tangents(self, positions: Array) -> Array:
        """Return the stiffness (k, 3, 3) [N/m] of each contact while its stick spring is slack.

        Args:
            positions: (n, 3) [m], of the nodes, the anchors at the contact points.
        """
        point = np.einsum("ka,kar->kr", self.weights, positions[self.nodes])
        depth = 0.5 * self.law.smoothing_m - (np.einsum("kr,kr->k", self.normal, point) - self.offset)
        pressing = self.stiffness * np.clip(depth / self.law.smoothing_m, 0.0, 1.0)
        dragging = 2.0 * self.friction / self.law.stick_m
        outer = self.normal[:, :, None] * self.normal[:, None, :]
        found = dragging[:, None, None] * np.eye(3) + (pressing - dragging)[:, None, None] * outer
        return self._with_glue(found)

    def stiffnesses(self, positions: Array) -> Array:
        """Return the stiffness (k, 3, 3) [N/m] of each contact, derivative of its gradient by its point.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        point = np.einsum("ka,kar->kr", self.weights, positions[self.nodes])
        depth = 0.5 * self.law.smoothing_m - (np.einsum("kr,kr->k", self.normal, point) - self.offset)
        pressing = self.stiffness * np.clip(depth / self.law.smoothing_m, 0.0, 1.0)
        u = point - self.anchor
        u -= np.einsum("kr,kr->k", self.normal, u)[:, None] * self.normal
        length = np.maximum(np.linalg.norm(u, axis=1), 1e-300)
        fraction = np.minimum(length / self.law.stick_m, 1.0)
        across = self.friction * np.where(fraction < 1.0, (2.0 - fraction) / self.law.stick_m, 1.0 / length)
        along = self.friction * 2.0 * (1.0 - fraction) / self.law.stick_m
        outer = self.normal[:, :, None] * self.normal[:, None, :]
        direction = u / length[:, None]
        slip = direction[:, :, None] * direction[:, None, :]
        return self._with_glue(
            (pressing - across)[:, None, None] * outer
            + across[:, None, None] * np.eye(3)
            + (along - across)[:, None, None] * slip
        )

    @property
    def glued(self) -> Mask:
        """(k,), which of them are glued."""
        return np.asarray(self.friction == GLUED)

    def _with_glue(self, stiffness: Array) -> Array:
        return np.where(self.glued[:, None, None], self.stiffness[:, None, None] * np.eye(3), stiffness)


@final
@dataclass(frozen=True)
class ContactForces:
    """Contact points of one step at its end.

    Args:
        point: (k, 3) [m], world.
        force: (k, 3) [N], on the film, world axes.
        normal_force: (k,) [N].
        distance: (k,) [m], from the obstacle's tangent plane, negative inside.
    """

    point: Array
    force: Array
    normal_force: Array
    distance: Array

    @property
    def pressing(self) -> int:
        """How many points press."""
        return int((self.normal_force > 0.0).sum())

    @property
    def depth_m(self) -> float:
        """Of the deepest of them [m]; 0 if none presses, negative while none has sunk in."""
        pressing = self.normal_force > 0.0
        return -float(self.distance[pressing].min()) if pressing.any() else 0.0
