"""How contacts with bodies go with them, and how stiff they are, film and film inertia included."""

from dataclasses import dataclass
from typing import Protocol, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.coupling.robots.soft_robot import SoftReply
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.state import SoftState, StepAccuracy


def rigid_motions(points: Array, origins: Array) -> Array:
    """Return how points (k, 3) [m] move (k, 3, 6) with translation and rotation about origins: [1, -S(arm)].

    Args:
        points: (k, 3) [m].
        origins: (3,) [m], of all, or (k, 3), of each.
    """
    motion = np.zeros((len(points), 3, 6))
    motion[:, :, :3] = np.eye(3)
    x, y, z = (points - origins).T
    motion[:, 0, 4], motion[:, 0, 5] = z, -y
    motion[:, 1, 3], motion[:, 1, 5] = -z, x
    motion[:, 2, 3], motion[:, 2, 4] = y, -x
    return motion


class SoftStepper(Protocol):
    """What gives way to forces on its nodes within a tick: the soft side."""

    @property
    def state(self) -> SoftState:
        """State after the newest step."""

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return (m, n, 3) [m] under forces (m, n, 3) [N]; None where the tangent is indefinite."""

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step."""

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> SoftReply:
        """Advance by one step, as closely as asked for."""

    def restore(self, before: SoftState) -> None:
        """Undo the last step."""


@final
@dataclass(frozen=True)
class Levers:
    """How the contacts with some bodies go with them; the arms stay what they are in a tick.

    Args:
        mine: (k,) those contacts.
        place: (k,) of each contact's body among the b bodies.
        arm: (k, 3) [m], from the centre of mass, world axes.
        count: b.
    """

    mine: IntArray
    place: IntArray
    arm: Array
    count: int

    @classmethod
    def of(cls, planes: ContactPlanes, bodies: IntArray, centers: Array, positions: Array) -> "Levers":
        """Return those of contacts with bodies (b,), ascending.

        Args:
            planes: contacts.
            bodies: (b,).
            centers: (b, 3) [m], of their masses.
            positions: (n, 3) [m], of the nodes.
        """
        mine = np.flatnonzero(np.isin(planes.body, bodies))
        place = np.searchsorted(bodies, planes.body[mine])
        points = np.einsum("ka,kar->kr", planes.weights[mine], positions[planes.nodes[mine]])
        return cls(mine, place, points - centers[place], len(bodies))

    def loads(self, force: Array) -> Array:
        """Return the loads (6 b,) of forces (k, 3) [N] at the contacts, about the centres of mass."""
        loads = np.zeros((self.count, 6))
        np.add.at(loads, self.place, np.concatenate([force, cross(self.arm, force)], axis=1))
        return loads.ravel()

    def shift(self, motion: Array) -> Array:
        """Return by how much the contacts go (k, 3) [m] with a motion (b, 6) of the bodies."""
        return np.asarray(motion[self.place, :3] + cross(motion[self.place, 3:], self.arm))

    def stiffness(
        self, planes: ContactPlanes, tangents: Array, soft: SoftStepper | None, tick_s: float
    ) -> Array:
        """Return S = G^T (K - K W H^-1 W^T K) G (6 b, 6 b): change of contact loads per motion of the bodies.

        G moves the contact points with the bodies, K are the contacts' tangents, W^T spreads forces to the
        nodes, H is the tangent of the film's time step.

        Args:
            planes: contacts.
            tangents: K (k, 3, 3) [N/m], of all contacts.
            soft: soft side, after its step; None for one that stays where it is.
            tick_s: length of the step [s].
        """
        pressed = np.flatnonzero(np.abs(tangents[self.mine]).max(axis=(1, 2)) > 0.0)
        stiffness = np.zeros((6 * self.count, 6 * self.count))
        if not len(pressed):
            return stiffness
        mine, place = self.mine[pressed], self.place[pressed]
        touched = np.unique(place)
        moved = np.zeros((len(mine), 3, len(touched), 6))  # the points with their body
        arms = rigid_motions(self.arm[pressed], np.zeros(3))
        moved[np.arange(len(mine)), :, np.searchsorted(touched, place)] = arms
        motion = moved.reshape(len(mine), 3, 6 * len(touched))
        push = np.einsum("krs,ksj->krj", tangents[mine], motion)
        own = np.einsum("kri,krj->ij", motion, push)
        if soft is not None:
            forces = spread(planes.nodes[mine], planes.weights[mine], push, len(soft.state.positions))
            following = soft.response(forces, planes, tick_s)
            if following is not None:
                own -= np.einsum("inr,jnr->ij", forces, following)
        columns = (6 * touched[:, None] + np.arange(6)).ravel()
        stiffness[np.ix_(columns, columns)] = own
        return stiffness


def spread(nodes: IntArray, weights: Array, push: Array, count: int) -> Array:
    """Return forces (j, n, 3) [N] on nodes from forces at contact points.

    Args:
        nodes: (k, 3) that each point combines.
        weights: (k, 3).
        push: (k, 3, j) [N], j cases.
        count: n.
    """
    total = np.zeros((count, push.shape[2], 3))
    for a in range(nodes.shape[1]):
        np.add.at(total, nodes[:, a], weights[:, a, None, None] * push.transpose(0, 2, 1))
    return np.ascontiguousarray(total.transpose(1, 0, 2))
