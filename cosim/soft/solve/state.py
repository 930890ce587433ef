"""States of a soft body in time, and its equilibria."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose, Wrench
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.contact.self_contact_pairs import FilmMemory
from cosim.soft.solve.branching import Branching


@final
@dataclass(frozen=True)
class SoftState:
    """State of a soft body.

    Args:
        positions: (n, 3) [m], world.
        velocities: (n, 3) [m/s].
        memory: (values,), internal variables of the elements, such as unwrapped hinge angles.
        earlier: positions and velocities one step before, for two-step integrators.
        touching: pairs of films that press on one another; None for none.
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
"""Positions (n, 3) [m] -> possible contacts near them, without friction; None for none."""


@final
@dataclass(frozen=True)
class Equilibrium:
    """A solved equilibrium.

    Args:
        state: at rest.
        world_from_flange: pose of the flange.
        loads: that act.
        wrench: exerted on the flange, at its origin, world axes.
        residual_N: largest out-of-balance component on a free node.
        iterations: Newton iterations spent since the equilibrium it was followed from.
        potential_J: potential energy, loads included.
        shifted: iterations that met an indefinite tangent.
        slides: how often Newton's method found nothing near on the way, and a damped slide went on; see
            `pseudo_time.slide`.
        negative_pivots: of its tangent, with frozen losses along cables: number of directions in which the
            potential falls, 0 if stable; None if loads have no potential.
        branchings: passed on the way.
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
    branchings: tuple[Branching, ...] = ()
