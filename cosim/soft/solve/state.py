"""States of a soft body: how it moves, how the flange holds it, and its equilibria."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Wrench
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.contact.self_contact_memory import FilmMemory
from cosim.soft.solve.held_nodes import HeldNodes, add_wrench, flange_axes, place_held


@final
@dataclass(frozen=True)
class Clamp:
    """Nodes held rigidly to the flange, as a whole or in single world components.

    Args:
        nodes: (k,) indices, ascending.
        offsets: (k, 3) [m], their places in the flange frame.
        components: (k, 3) bool, the world components in which each is held.
    """

    nodes: Annotated[IntArray, ("k",)]
    offsets: Annotated[Array, ("k", 3)]
    components: Annotated[Mask, ("k", 3)]

    @classmethod
    def of_base(cls, body: SoftBody) -> Clamp:
        """Return the clamp of the body's base nodes, where they are drawn."""
        nodes = np.unique(body.base)
        return cls(nodes, body.positions[nodes], np.ones((len(nodes), 3), dtype=bool))

    def holds_as(self, other: Clamp) -> bool:
        """Return whether it holds the same nodes, at the same places, as another clamp."""
        if self is other:
            return True
        pairs = (self.nodes, other.nodes), (self.offsets, other.offsets), (self.components, other.components)
        return all(np.array_equal(one, two) for one, two in pairs)

    def extended(self, nodes: IntArray, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds `nodes` (m,) as a whole; see `holding`."""
        held = np.zeros((len(positions), 3), dtype=bool)
        held[nodes] = True
        return self.holding(held, positions, world_from_flange)

    def holding(self, held: Mask, positions: Array, world_from_flange: Pose) -> Clamp:
        """Return a clamp that also holds further components where they are now.

        Args:
            held: (n, 3) bool, components to hold besides those held already.
            positions: (n, 3) [m], world, of all nodes.
            world_from_flange: present pose of the flange.
        """
        mask = self.mask(len(positions)) | held
        offsets = world_from_flange.inverse().apply(positions)
        whole = self.components.all(axis=1)
        offsets[self.nodes[whole]] = self.offsets[whole]
        nodes = np.flatnonzero(mask.any(axis=1))
        return Clamp(nodes, offsets[nodes], mask[nodes])

    def without(self, nodes: IntArray) -> Clamp:
        """Return a clamp that lets the given nodes go."""
        kept = ~np.isin(self.nodes, nodes)
        return Clamp(self.nodes[kept], self.offsets[kept], self.components[kept])

    def mask(self, count: int) -> Mask:
        """Return (count, 3) bool, true where a component is held."""
        held = np.zeros((count, 3), dtype=bool)
        held[self.nodes] = self.components
        return held

    def place(self, positions: Array, world_from_flange: Pose) -> Array:
        """Return the positions (n, 3) [m] with the held components where the flange has them."""
        placed = np.array(positions, order="C")
        place_held(self.held, flange_axes(world_from_flange), placed)
        return placed

    @cached_property
    def held(self) -> HeldNodes:
        """Its arrays, for kernels."""
        nodes, offsets = np.array(self.nodes, order="C"), np.array(self.offsets, order="C")
        return HeldNodes(nodes, offsets, np.array(self.components, order="C"))

    @cached_property
    def _whole(self) -> bool:
        """Whether all nodes are held in all components."""
        return bool(self.components.all())

    def reaction(self, gradient: Array) -> Array:
        """Return the force (k, 3) [N] that the flange supplies to each held node, free components zero.

        Args:
            gradient: (n, 3) [N], of the potential, inertia included.
        """
        held = gradient[self.nodes]
        return held if self._whole else np.where(self.components, held, 0.0)

    def wrench(self, gradient: Array, positions: Array, world_from_flange: Pose) -> Wrench:
        """Return what the body exerts on the flange, at its origin, world axes.

        force = -sum_k r_k, torque = -sum_k (x_k - o) x r_k, with r the reactions at the held nodes.

        Args:
            gradient: (n, 3) [N].
            positions: (n, 3) [m], world.
            world_from_flange: pose of the flange, o its origin.
        """
        wrench = np.zeros(6)
        add_wrench(self.held, gradient, positions, flange_axes(world_from_flange), wrench)
        return Wrench.owning(wrench[:3], wrench[3:])


@final
@dataclass(frozen=True)
class SoftState:
    """What the next step of a soft body depends on.

    Args:
        positions: (n, 3) [m], world.
        velocities: (n, 3) [m/s].
        memory: (values,), what the elements remember, such as unwrapped hinge angles.
        earlier: positions and velocities one step before, for two-step integrators.
        touching: films that press on one another; None for none.
    """

    positions: Annotated[Array, ("nodes", 3)]
    velocities: Annotated[Array, ("nodes", 3)]
    memory: Annotated[Array, ("values",)]
    earlier: tuple[Annotated[Array, ("nodes", 3)], Annotated[Array, ("nodes", 3)]] | None = None
    touching: FilmMemory | None = None

    @classmethod
    def drawn(cls, body: SoftBody, world_from_flange: Pose) -> SoftState:
        """Return the drawn shape, at rest on the flange."""
        positions = np.ascontiguousarray(world_from_flange.apply(body.positions))
        return cls(positions, np.zeros_like(positions), body.first_memory())

    @classmethod
    def at_rest(cls, positions: Array, memory: Array, touching: FilmMemory | None = None) -> SoftState:
        """Return a state without velocity."""
        return cls(positions, np.zeros_like(positions), memory, None, touching)

    def carried(self, motion: Pose) -> SoftState:
        """Return the state moved rigidly by `motion` (world to world)."""
        turn = motion.rotation.T
        return SoftState(
            np.ascontiguousarray(motion.apply(self.positions)), self.velocities @ turn, self.memory, None,
            None if self.touching is None else self.touching.carried(motion),
        )  # fmt: skip


Obstacles: TypeAlias = Callable[[Array], ContactPlanes | None]
"""Positions (n, 3) [m] -> what may be touched near them, without friction; None for nothing."""


@final
@dataclass(frozen=True)
class Equilibrium:
    """A solved equilibrium.

    Args:
        state: at rest.
        world_from_flange: pose of the flange.
        loads: that it carries.
        wrench: exerted on the flange, at its origin, world axes.
        residual_N: largest out-of-balance component on a free node.
        iterations: Newton iterations spent since the equilibrium it was followed from.
        potential_J: potential energy, loads included.
        shifted: iterations that met an indefinite tangent.
        slides: how often on the way Newton's method found nothing near and a damped slide led on; see
            `equilibrium.slide`.
        negative_pivots: of its tangent, see `NewtonResult`.
    """

    state: SoftState
    world_from_flange: Pose
    loads: Loads
    wrench: Wrench
    residual_N: float
    iterations: int
    potential_J: float
    shifted: int
    slides: int = 0
    negative_pivots: int | None = None


@final
@dataclass(frozen=True)
class BegunStep:
    """Where a row of ticks has left a step of a film; `StepWork` and the bed hold the rest until the next.

    Args:
        state: from which the step begins.
        x: (n, 3) [m], where its end is.
        base: (n, 3) [m], as `film_step` leaves it.
        memory: (values,), of the elements there.
        iterations: so far.
        residual: [N].
    """

    state: SoftState
    x: Array
    base: Array
    memory: Array
    iterations: int
    residual: float
