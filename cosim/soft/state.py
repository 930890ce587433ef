"""State of a soft body, and how it is held by the flange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.soft.body import SoftBody
from cosim.soft.surface import dihedral_angle


@final
@dataclass(frozen=True)
class Clamp:
    """Nodes held rigidly to the flange.

    Args:
        nodes: (k,) indices.
        offsets: (k, 3) [m], their places in the flange frame.
    """

    nodes: IntArray
    offsets: Array

    @classmethod
    def of_base(cls, body: SoftBody) -> Clamp:
        """Return the clamp of the body's base nodes, where they are drawn."""
        return cls(body.base, body.positions[body.base])

    def extended(self, nodes: IntArray, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds `nodes` where they are now.

        Args:
            nodes: (m,) further nodes.
            positions: (n, 3) [m], world, of all nodes.
            world_from_flange: present pose of the flange.
        """
        new = np.setdiff1d(nodes, self.nodes)
        offsets = world_from_flange.inverse().apply(positions[new])
        return Clamp(np.concatenate([self.nodes, new]), np.concatenate([self.offsets, offsets]))

    def mask(self, count: int) -> Mask:
        """Return (count,) bool, true where a node is held."""
        held = np.zeros(count, dtype=bool)
        held[self.nodes] = True
        return held

    def place(self, positions: Array, world_from_flange: Pose) -> Array:
        """Return the positions (n, 3) [m] with the held nodes where the flange has them."""
        placed = np.array(positions)
        placed[self.nodes] = world_from_flange.apply(self.offsets)
        return placed

    def wrench(self, gradient: Array, positions: Array, world_from_flange: Pose) -> Wrench:
        """Return what the body exerts on the flange, at its origin, world axes.

        force = -sum_k r_k, torque = -sum_k (x_k - o) x r_k, with r the gradient of the potential (inertia
        included) at the held nodes: the force that the flange must supply.

        Args:
            gradient: (n, 3) [N].
            positions: (n, 3) [m], world.
            world_from_flange: pose of the flange, o its origin.
        """
        reaction = gradient[self.nodes]
        arm = positions[self.nodes] - world_from_flange.translation
        return Wrench(-reaction.sum(axis=0), -np.cross(arm, reaction).sum(axis=0))


@final
@dataclass(frozen=True)
class SoftState:
    """What the next step of a soft body depends on.

    Args:
        positions: (n, 3) [m], world.
        velocities: (n, 3) [m/s].
        angles: (h,) [rad], unwrapped hinge angles.
        earlier: positions and velocities one step before, for two-step integrators.
    """

    positions: Array
    velocities: Array
    angles: Array
    earlier: tuple[Array, Array] | None = None

    @classmethod
    def drawn(cls, body: SoftBody, world_from_flange: Pose) -> SoftState:
        """Return the drawn shape, at rest on the flange."""
        positions = np.ascontiguousarray(world_from_flange.apply(body.positions))
        return cls(positions, np.zeros_like(positions), dihedral_angle(body.positions, body.hinges.nodes))

    @classmethod
    def at_rest(cls, positions: Array, angles: Array) -> SoftState:
        """Return a state without velocity."""
        return cls(positions, np.zeros_like(positions), angles)

    def carried(self, motion: Pose) -> SoftState:
        """Return the state moved rigidly by `motion` (world to world)."""
        turn = motion.rotation.T
        return SoftState(
            np.ascontiguousarray(motion.apply(self.positions)), self.velocities @ turn, self.angles
        )
