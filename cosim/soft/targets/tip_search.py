"""Gauss-Newton on the deformed tip's pose, and the flange pose that brings the tip to a target.

What follows equilibria and knows how their tip moves: the film itself, or a model that stands for it.

A step solves the linear model J change = missing within a bound. It is taken when the equilibrium it leads to
is stable and brings the tip nearer by at least a tenth of what the linear model promised; else it is cut to a
quarter. The bound of the next step follows from how well the model foretold the last one.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 4.1 and 10.3.

Moving the flange by a translation d and a rotation w (world axes, about its origin o) carries the tip p
rigidly and turns gravity by -w seen from the flange:
    dp = d + w x (p - o) + (dp/dgravity) (gravity x w)     (both with w also turned on the direction).
Source: implicit function theorem; DESIGN section 4 for the exact tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix, rotation_from_vector
from cosim.errors import ConvergenceError, OutOfRangeError, UnreachableError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.state import Equilibrium
from cosim.soft.targets.tip_target import TargetOptions, TargetSolution, TipTarget


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


_ACCEPTED = 0.1  # share of the promised gain
_WELL_FORETOLD = 0.75
_CUT = 0.25
_LEAST_PROMISE = 1e-3  # of the distance; what promises less is not worth an equilibrium

_Linear: TypeAlias = tuple[Array, Array]
"""J (m, k) and what is missing (m,) [m], angles times the lever."""


class Unknowns(Protocol):
    """What is changed to bring the tip to its target."""

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        """Return the tip and d(tip motion)/d(unknowns) (6, k).

        Raises:
            ConvergenceError: the equilibrium is not stable.
        """

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        """Return the change (k,) of size `bound` at most that makes matrix change nearest to missing."""

    def size(self, change: Array) -> float:
        """Return the size of a change (k,); 1 for the largest that is ever tried in one step."""

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        """Return pose and loads after a change (k,)."""


@final
@dataclass(frozen=True)
class Ended:
    """Where a search ended.

    Args:
        nearest: the solution, or the nearest to one.
        why_not: what ended the search before the target; empty for a solution.
    """

    nearest: TargetSolution
    why_not: str


@final
class TipSearch:
    """A search for the unknowns that bring the tip to a target.

    Args:
        follower: of equilibria.
        target: of the tip, world.
        options: bounds.
        unknowns: what is changed.
    """

    def __init__(
        self, follower: Follower, target: TipTarget, options: TargetOptions, unknowns: Unknowns
    ) -> None:
        self._follower, self._target = follower, target
        self._options, self._unknowns = options, unknowns

    def run(self, begin: Equilibrium) -> Ended:
        """Search from an equilibrium on."""
        here, rounds, bound = self.reached(begin, 0), 1, 1.0
        if self._options.met(here):
            return Ended(here, "")
        try:
            matrix, missing = self._linear(begin)
        except ConvergenceError as error:
            return Ended(here, str(error))
        why_not = left = ""
        while True:
            change = self._unknowns.step(here.equilibrium, matrix, missing, bound)
            distance = float(np.linalg.norm(missing))
            promised = distance - float(np.linalg.norm(missing - matrix @ change))
            if not promised > _LEAST_PROMISE * distance:
                return Ended(here, why_not or "no small change brings it nearer")
            try:
                there = self._after(here.equilibrium, change, rounds)
                if self._options.met(there):
                    return Ended(there, "")
                gain = (distance - self._distance(there)) / promised
                if gain >= _ACCEPTED and rounds < self._options.iterations_max:
                    matrix, missing = self._linear(there.equilibrium)
            except ConvergenceError as error:
                why_not, gain = f"beyond it {error}", -np.inf
                if isinstance(error, OutOfRangeError):
                    left = f"; on the way {error.place}; fidelity = 'lumped' has no such end"
            if gain < _ACCEPTED:
                bound = _CUT * min(bound, self._unknowns.size(change))
                continue
            if rounds == self._options.iterations_max:
                return Ended(there, f"the limit of {rounds} iterations was reached{left}")
            here, rounds, why_not = there, rounds + 1, ""
            bound = min(1.0, 2.0 * bound) if gain > _WELL_FORETOLD else bound

    def reached(self, here: Equilibrium, rounds: int) -> TargetSolution:
        """Return how far off an equilibrium's tip is after some rounds of a search."""
        tip = TipFrame.of(self._follower.body, here.state.positions)
        return TargetSolution(here, *self._target.distance(tip), rounds)

    def _after(self, here: Equilibrium, change: Array, rounds: int) -> TargetSolution:
        pose, loads = self._unknowns.moved(here, change)
        return self.reached(self._follower.follow(here, pose, loads), rounds)

    def _distance(self, found: TargetSolution) -> float:
        return float(np.hypot(found.position_error_m, self._options.lever_m * found.angle_error_rad))

    def _linear(self, here: Equilibrium) -> _Linear:
        tip, jacobian = self._unknowns.jacobian(here)
        rows, missing = self._target.error(tip)
        weight = np.where(rows[:, :3].any(axis=1), 1.0, self._options.lever_m)
        return weight[:, None] * (rows @ jacobian), weight * missing


_LARGEST_TURN_RAD = 0.8
_LARGEST_SHIFT_M = 5.0  # a shift hardly bends the law: only a search that is held back feels it


@final
@dataclass(frozen=True)
class _FlangeMotion:
    """A small motion of the flange (6,): translation [m] and rotation [rad], world axes."""

    follower: Follower
    lever_m: float

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(here)
        tip = sensitivity.tip
        gravity = np.array(here.loads.gravity)
        motion = np.eye(6)
        motion[:3, 3:] = -cross_matrix(tip.position - here.world_from_flange.translation)
        motion[:, 3:] += sensitivity.to_gravity() @ cross_matrix(gravity)
        return tip, motion

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        scale = np.array([1.0, 1.0, 1.0, *([1.0 / self.lever_m] * 3)])
        change = scale * np.linalg.lstsq(matrix * scale, missing, rcond=1e-9)[0]
        return np.asarray(change * min(1.0, bound / max(self.size(change), 1e-12)))

    def size(self, change: Array) -> float:
        shift, turn = float(np.linalg.norm(change[:3])), float(np.linalg.norm(change[3:]))
        return max(shift / _LARGEST_SHIFT_M, turn / _LARGEST_TURN_RAD)

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pose = here.world_from_flange
        turned = rotation_from_vector(change[3:]) @ pose.rotation
        return Pose(turned, pose.translation + change[:3]), here.loads


def find_flange_pose(
    solver: EquilibriumSolver | Follower,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions | None = None,
) -> TargetSolution:
    """Find the flange pose for which the deformed tip meets the target; loads stay.

    Args:
        solver: follows equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution.
    """
    options, follower = options or TargetOptions(), follower_of(solver)
    ended = TipSearch(follower, target, options, _FlangeMotion(follower, options.lever_m)).run(begin)
    if not ended.why_not:
        return ended.nearest
    nearest = ended.nearest
    place = np.round(nearest.equilibrium.world_from_flange.translation, 4).tolist()
    raise UnreachableError(
        f"no flange pose found that brings the tip to the target; the nearest, after {nearest.iterations} "
        f"iterations, is {nearest.off()} off, with the flange at {place} m: {ended.why_not}",
        nearest,
    )
