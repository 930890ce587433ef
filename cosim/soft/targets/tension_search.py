"""Sag compensation by the cables: the tensions that bring the deformed tip to a target; the flange stays.

Gauss-Newton first. Where it ends before the target, the cables are pulled along straight lines of tension
from the present state on, and a height is looked for between any two states that have it between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, UnreachableError
from cosim.soft.body.loads import Loads
from cosim.soft.body.tip_frame import TipFrame
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.state import Equilibrium
from cosim.soft.targets.target_solution import TargetOptions, TargetSolution
from cosim.soft.targets.tension_sweep import TensionSweep, pull_lines, tensions_text
from cosim.soft.targets.tip_follower import Follower, follower_of
from cosim.soft.targets.tip_search import Ended, TipSearch
from cosim.soft.targets.tip_target import TipTarget

_LARGEST_CHANGE_N = 10.0


@final
@dataclass(frozen=True)
class _TensionChange:
    """A change of the cable tensions (cables,) [N] that leaves none negative."""

    follower: Follower
    tension_max_N: float

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(here)
        return sensitivity.tip, sensitivity.to_tension()

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        from scipy.optimize import lsq_linear  # here: it takes long to load

        tension = np.array(here.loads.cable_tension_N)
        # a slight preference for the smallest change decides among equivalent tensions
        keep = 1e-6 * np.linalg.norm(matrix) * np.eye(len(tension))
        lower = np.maximum(-tension, -bound * _LARGEST_CHANGE_N)
        upper = np.minimum(np.maximum(self.tension_max_N - tension, 0.0), bound * _LARGEST_CHANGE_N)
        problem = np.concatenate([matrix, keep]), np.concatenate([missing, np.zeros(len(tension))])
        return np.asarray(lsq_linear(*problem, bounds=(lower - 1e-12, upper + 1e-12)).x)

    def size(self, change: Array) -> float:
        return float(np.abs(change).max(initial=0.0)) / _LARGEST_CHANGE_N

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pulled = np.maximum(np.array(here.loads.cable_tension_N) + change, 0.0)
        return here.world_from_flange, replace(here.loads, cable_tension_N=tuple(pulled.tolist()))


def find_tensions(
    solver: EquilibriumSolver | Follower,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions | None = None,
) -> TargetSolution:
    """Find the cable tensions, none negative, that bring the sagging tip to the target; the flange stays.

    Args:
        solver: follows equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world; a point or only a height.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution, the message says what was reached.
    """
    options, follower = options or TargetOptions(), follower_of(solver)
    search = TipSearch(follower, target, options, _TensionChange(follower, options.tension_max_N))
    ended = search.run(begin)
    if not ended.why_not:
        return ended.nearest
    sweeps: list[TensionSweep] = []
    for line in pull_lines(follower, begin, options.tension_max_N):
        sweeps.append(TensionSweep(follower, begin, line, target))
        for found in sweeps[-1].crossings(options.position_tolerance_m):
            solution = search.reached(found, ended.nearest.iterations)
            if options.met(solution) and _stable(follower, found):
                return solution
    again = [search.run(sweep.nearest) for sweep in sweeps]
    ended = min([ended, *again], key=lambda each: each.nearest.position_error_m)
    if not ended.why_not:
        return ended.nearest
    raise UnreachableError(_refusal(ended, target, sweeps, options.tension_max_N), ended.nearest)


def _stable(follower: Follower, here: Equilibrium) -> bool:
    try:
        follower.sensitivity(here)
    except ConvergenceError:
        return False
    return True


def _refusal(ended: Ended, target: TipTarget, sweeps: list[TensionSweep], tension_max_N: float) -> str:
    nearest = ended.nearest
    goal = "the target" if target.height is None else f"a height of {target.height:g} m"
    message = (
        f"no cable tensions of 0 to {tension_max_N:g} N found that bring the tip to {goal}; the nearest is "
        f"{nearest.off()} off at {tensions_text(nearest.equilibrium)}: {ended.why_not}"
    )
    if target.height is None:
        lost = dict.fromkeys(sweep.lost for sweep in sweeps if sweep.lost not in message)
        return "; ".join([message, *lost])
    return "; ".join([message, *(sweep.told() for sweep in sweeps if sweep.walked)])
