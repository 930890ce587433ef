"""What follows equilibria and knows how their tip moves: the film itself, or a model that stands for it."""

from __future__ import annotations

from typing import Protocol, final

from cosim.base.frames import Array, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.tip_frame import TipFrame
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.state import Equilibrium


class TipSensitivity(Protocol):
    """How a tip moves: see `cosim.soft.solve.sensitivity.Sensitivity`."""

    tip: TipFrame

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3); the flange stays."""

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables); the flange stays."""


class Follower(Protocol):
    """What follows equilibria of a body and knows how its tip moves, by whatever model."""

    @property
    def body(self) -> SoftBody:
        """Whose tip it is."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads."""

    def sensitivity(self, here: Equilibrium) -> TipSensitivity:
        """Return how the tip moves at an equilibrium.

        Raises:
            ConvergenceError: it is not stable there.
        """


@final
class _FilmFollower:
    """The film itself."""

    def __init__(self, solver: EquilibriumSolver) -> None:
        self.follow = solver.follow
        self._solver = solver.solver

    @property
    def body(self) -> SoftBody:
        """Whose tip it is."""
        return self._solver.system.body

    def sensitivity(self, here: Equilibrium) -> Sensitivity:
        """Return how the tip moves at an equilibrium."""
        return Sensitivity(self._solver, here)


def follower_of(solver: EquilibriumSolver | Follower) -> Follower:
    """Return what follows the equilibria of a solver, or what already does."""
    return _FilmFollower(solver) if isinstance(solver, EquilibriumSolver) else solver
