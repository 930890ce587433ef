"""Lever arms of contacts with bodies, and the contacts' stiffness in series with film and film inertia."""

from dataclasses import dataclass
from typing import Protocol, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.coupling.robots.soft_step import SoftReply
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepAccuracy


def rigid_motions(points: Array, origins: Array) -> Array:
    """Return the Jacobians [1, -S(arm)] (k, 3, 6) of points (k, 3) [m] by translation and rotation of a body.

    Args:
        points: (k, 3) [m].
        origins: (3,) [m], centre of rotation of all points, or (k, 3), of each.
    """
    motion = np.zeros((len(points), 3, 6))
    motion[:, :, :3] = np.eye(3)
    x, y, z = (points - origins).T
    motion[:, 0, 4], motion[:, 0, 5] = z, -y
    motion[:, 1, 3], motion[:, 1, 5] = -z, x
    motion[:, 2, 3], motion[:, 2, 4] = y, -x
    return motion


class SoftStepper(Protocol):
    """The soft robot as contact sees it: steps, and its response to forces on nodes within a step."""

    @property
    def state(self) -> SoftState:
        """State after the newest step."""

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return displacements (m, n, 3) [m] by forces (m, n, 3) [N]; None if the tangent is indefinite."""

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step."""

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> SoftReply:
        """Advance by one step to a given accuracy."""

    def restore(self, before: SoftState) -> None:
        """Undo the last step."""


@final
@dataclass(frozen=True)
class Levers:
    """Lever arms of the contacts with some bodies; constant within a tick.

    Args:
        contacts: (k,) indices of those contacts.
        body: (k,) index of each contact's body among the b bodies.
        arm: (k, 3) [m], from the centre of mass, world axes.
        count: b.
    """

    contacts: IntArray
    body: IntArray
    arm: Array
    count: int

    @classmethod
    def of(cls, planes: ContactPlanes, bodies: IntArray, centers: Array, positions: Array) -> "Levers":
        """Return the lever arms of the contacts with bodies (b,), ascending.

        Args:
            planes: all contacts.
            bodies: (b,).
            centers: (b, 3) [m], of their masses.
            positions: (n, 3) [m], of the nodes.
        """
        contacts = np.flatnonzero(np.isin(planes.body, bodies))
        body = np.searchsorted(bodies, planes.body[contacts])
        points = np.einsum("ka,kar->kr", planes.weights[contacts], positions[planes.nodes[contacts]])
        return cls(contacts, body, points - centers[body], len(bodies))

    def loads(self, force: Array) -> Array:
        """Return the loads (6 b,) of forces (k, 3) [N] at the contacts, about the centres of mass."""
        loads = np.zeros((self.count, 6))
        np.add.at(loads, self.body, np.concatenate([force, cross(self.arm, force)], axis=1))
        return loads.ravel()

    def shift(self, motion: Array) -> Array:
        """Return the displacements (k, 3) [m] of the contacts by a motion (b, 6) of the bodies."""
        return np.asarray(motion[self.body, :3] + cross(motion[self.body, 3:], self.arm))

    def stiffness(
        self, planes: ContactPlanes, tangents: Array, soft: SoftStepper | None, tick_s: float
    ) -> Array:
        """Return S = G^T (K - K W H^-1 W^T K) G (6 b, 6 b): change of contact loads per motion of the bodies.

        G is the Jacobian of the contact points by the bodies' motion, K are the contacts' tangents, W^T
        spreads forces to the nodes, H is the tangent of the film's time step.

        Args:
            planes: all contacts.
            tangents: K (k, 3, 3) [N/m], of all contacts.
            soft: soft robot after its step; None for a rigid film.
            tick_s: length of the step [s].
        """
        pressed = np.flatnonzero(np.abs(tangents[self.contacts]).max(axis=(1, 2)) > 0.0)
        stiffness = np.zeros((6 * self.count, 6 * self.count))
        if not len(pressed):
            return stiffness
        contacts, body = self.contacts[pressed], self.body[pressed]
        touched = np.unique(body)
        moved = np.zeros((len(contacts), 3, len(touched), 6))
        arms = rigid_motions(self.arm[pressed], np.zeros(3))
        moved[np.arange(len(contacts)), :, np.searchsorted(touched, body)] = arms
        jacobian = moved.reshape(len(contacts), 3, 6 * len(touched))
        push = np.einsum("krs,ksj->krj", tangents[contacts], jacobian)
        series = np.einsum("kri,krj->ij", jacobian, push)
        if soft is not None:
            forces = spread(planes.nodes[contacts], planes.weights[contacts], push, len(soft.state.positions))
            displacements = soft.response(forces, planes, tick_s)
            if displacements is not None:
                series -= np.einsum("inr,jnr->ij", forces, displacements)
        columns = (6 * touched[:, None] + np.arange(6)).ravel()
        stiffness[np.ix_(columns, columns)] = series
        return stiffness


def spread(nodes: IntArray, weights: Array, push: Array, count: int) -> Array:
    """Return forces (j, n, 3) [N] on nodes from forces at contact points.

    Args:
        nodes: (k, 3), of each point's triangle.
        weights: (k, 3), barycentric.
        push: (k, 3, j) [N], j cases.
        count: n.
    """
    total = np.zeros((count, push.shape[2], 3))
    for a in range(nodes.shape[1]):
        np.add.at(total, nodes[:, a], weights[:, a, None, None] * push.transpose(0, 2, 1))
    return np.ascontiguousarray(total.transpose(1, 0, 2))
