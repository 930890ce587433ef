"""Gauss-Newton on the deformed tip's pose, held back by a trust region.

A step solves the linear model J change = missing within a bound. It is taken when the equilibrium it leads to
is stable and brings the tip nearer by at least a tenth of what the linear model promised; else it is cut to a
quarter. The bound of the next step follows from how well the model foretold the last one.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 4.1 and 10.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.soft.body.loads import Loads
from cosim.soft.body.tip_frame import TipFrame
from cosim.soft.solve.state import Equilibrium
from cosim.soft.targets.target_solution import TargetOptions, TargetSolution
from cosim.soft.targets.tip_follower import Follower
from cosim.soft.targets.tip_target import TipTarget

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
