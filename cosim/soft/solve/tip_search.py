"""Gauss-Newton search for unknowns that bring the deformed tip to a target, on the film or a model of it.

A step solves the linear model J change = missing within a bound. It is accepted if the equilibrium that it
leads to is stable and brings the tip nearer by at least a tenth of the predicted gain; otherwise it is cut to
a quarter. The bound of the next step depends on how well the model predicted the last one.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 4.1 and 10.3.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_target import TargetOptions, TargetSolution, TipTarget


class TipSensitivity(Protocol):
    """Derivatives of the tip's motion, see `cosim.soft.solve.sensitivity.Sensitivity`."""

    tip: TipFrame

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3) for a fixed flange."""

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables) for a fixed flange."""


class Follower(Protocol):
    """Follows equilibria of a body, and returns the sensitivity of its tip, by any model."""

    @property
    def body(self) -> SoftBody:
        """The body with the tip."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads."""

    def sensitivity(self, equilibrium: Equilibrium) -> TipSensitivity:
        """Return the sensitivity of the tip at an equilibrium.

        Raises:
            ConvergenceError: it is not stable there.
        """


_ACCEPTED = 0.1  # fraction of the predicted gain
_WELL_PREDICTED = 0.75
_CUT = 0.25
_LEAST_GAIN = 1e-3  # predicted gain over the distance, below which the search ends

_Linear: TypeAlias = tuple[Array, Array]
"""J (m, k) and the remaining motion of the tip (m,) [m], angles times the lever."""


class Unknowns(Protocol):
    """Unknowns that are changed to bring the tip to its target."""

    def jacobian(self, equilibrium: Equilibrium) -> tuple[TipFrame, Array]:
        """Return the tip and d(tip motion)/d(unknowns) (6, k).

        Raises:
            ConvergenceError: the equilibrium is not stable.
        """

    def step(self, equilibrium: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        """Return the change (k,) of at most size `bound` that minimises |matrix change - missing|."""

    def size(self, change: Array) -> float:
        """Return the size of a change (k,), relative to the largest allowed in one step."""

    def moved(self, equilibrium: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        """Return pose and loads after a change (k,)."""


@final
@dataclass(frozen=True)
class SearchEnd:
    """Result of a search.

    Args:
        nearest: the solution, or the trial nearest to the target.
        reason: why the search failed; empty for a solution.
    """

    nearest: TargetSolution
    reason: str


@final
class TipSearch:
    """A search for the unknowns that bring the tip to a target.

    Args:
        follower: of equilibria.
        target: of the tip, world.
        options: bounds.
        unknowns: to change.
    """

    def __init__(
        self, follower: Follower, target: TipTarget, options: TargetOptions, unknowns: Unknowns
    ) -> None:
        self._follower, self._target = follower, target
        self._options, self._unknowns = options, unknowns

    def run(self, begin: Equilibrium) -> SearchEnd:
        """Search, starting from an equilibrium.

        If cables have a memory of sliding, every trial is followed from `begin`, as a run would reach it.
        """
        current, rounds, bound = self.evaluate(begin, 0), 1, 1.0
        slides = any(cable.remembers for cable in self._follower.body.cables)
        if self._options.met(current):
            return SearchEnd(current, "")
        try:
            matrix, missing = self._linear(begin)
        except ConvergenceError as error:
            return SearchEnd(current, str(error))
        reason = range_note = ""
        while True:
            change = self._unknowns.step(current.equilibrium, matrix, missing, bound)
            distance = float(np.linalg.norm(missing))
            predicted = distance - float(np.linalg.norm(missing - matrix @ change))
            if not predicted > _LEAST_GAIN * distance:
                return SearchEnd(current, reason or "no small change brings it nearer")
            try:
                pose_and_loads = self._unknowns.moved(current.equilibrium, change)
                start = begin if slides else current.equilibrium
                trial = self.evaluate(self._follower.follow(start, *pose_and_loads), rounds)
                if self._options.met(trial):
                    return SearchEnd(trial, "")
                gain = (distance - self._distance(trial)) / predicted
                if gain >= _ACCEPTED and rounds < self._options.iterations_max:
                    matrix, missing = self._linear(trial.equilibrium)
            except ConvergenceError as error:
                reason, gain = f"beyond it {error}", -np.inf
                if isinstance(error, OutOfRangeError):
                    range_note = f"; on the way {error.place}; fidelity = 'lumped' has no such end"
            if gain < _ACCEPTED:
                bound = _CUT * min(bound, self._unknowns.size(change))
                continue
            if rounds == self._options.iterations_max:
                return SearchEnd(trial, f"the limit of {rounds} iterations was reached{range_note}")
            current, rounds, reason = trial, rounds + 1, ""
            bound = min(1.0, 2.0 * bound) if gain > _WELL_PREDICTED else bound

    def evaluate(self, equilibrium: Equilibrium, rounds: int) -> TargetSolution:
        """Return an equilibrium with the errors of its tip, after some rounds of a search."""
        tip = TipFrame.of(self._follower.body, equilibrium.state.positions)
        return TargetSolution(equilibrium, *self._target.distance(tip), rounds)

    def _distance(self, solution: TargetSolution) -> float:
        return float(np.hypot(solution.position_error_m, self._options.lever_m * solution.angle_error_rad))

    def _linear(self, equilibrium: Equilibrium) -> _Linear:
        tip, jacobian = self._unknowns.jacobian(equilibrium)
        rows, missing = self._target.error(tip)
        weight = np.where(rows[:, :3].any(axis=1), 1.0, self._options.lever_m)
        return weight[:, None] * (rows @ jacobian), weight * missing
