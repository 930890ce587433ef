"""Search for cable tensions that bring the deformed tip to a target, with a fixed flange.

The Gauss-Newton search comes first. If it fails, tensions are swept along straight lines from the present
state, and a height is searched for between any two states on either side of it.
"""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, UnreachableError
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tension_sweep import TensionSweep, pull_lines, tensions_text
from cosim.soft.solve.tip_search import Follower, SearchEnd, TipSearch
from cosim.soft.solve.tip_target import TargetOptions, TargetSolution, TipTarget

_LARGEST_CHANGE_N = 10.0


@final
@dataclass(frozen=True)
class _TensionChange:
    """A change of the cable tensions (cables,) [N] that leaves none negative."""

    follower: Follower
    tension_max_N: float

    def jacobian(self, equilibrium: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(equilibrium)
        return sensitivity.tip, sensitivity.to_tension()

    def step(self, equilibrium: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        tension = np.array(equilibrium.loads.cable_tension_N)
        # a small regularisation decides among equivalent tensions
        regularisation = 1e-6 * np.linalg.norm(matrix) * np.eye(len(tension))
        lower = np.maximum(-tension, -bound * _LARGEST_CHANGE_N) - 1e-12
        upper = np.minimum(np.maximum(self.tension_max_N - tension, 0.0), bound * _LARGEST_CHANGE_N) + 1e-12
        problem = np.concatenate([matrix, regularisation]), np.concatenate([missing, np.zeros(len(tension))])
        free = np.linalg.lstsq(*problem, rcond=-1)[0]
        if ((free >= lower) & (free <= upper)).all():
            return np.asarray(free)
        from scipy.optimize import lsq_linear  # here: few steps meet a bound, and it takes long to load

        return np.asarray(lsq_linear(*problem, bounds=(lower, upper)).x)

    def size(self, change: Array) -> float:
        return float(np.abs(change).max(initial=0.0)) / _LARGEST_CHANGE_N

    def moved(self, equilibrium: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pulled = np.maximum(np.array(equilibrium.loads.cable_tension_N) + change, 0.0)
        return equilibrium.world_from_flange, replace(
            equilibrium.loads, cable_tension_N=tuple(pulled.tolist())
        )


def find_tensions(
    follower: Follower, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
) -> TargetSolution:
    """Find the cable tensions, none negative, that bring the deformed tip to the target; the flange is fixed.

    Args:
        follower: of equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world; a point or only a height.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution.
    """
    options = options or TargetOptions()
    search = TipSearch(follower, target, options, _TensionChange(follower, options.tension_max_N))
    search_end = search.run(begin)
    if not search_end.reason:
        return search_end.nearest
    sweeps: list[TensionSweep] = []
    for line in pull_lines(follower, begin, options.tension_max_N):
        sweeps.append(TensionSweep(follower, begin, line, target))
        for crossing in sweeps[-1].crossings(options.position_tolerance_m):
            solution = search.evaluate(crossing, search_end.nearest.iterations)
            if options.met(solution) and _stable(follower, crossing):
                return solution
    further_ends = [search.run(sweep.nearest) for sweep in sweeps]
    search_end = min([search_end, *further_ends], key=lambda end: end.nearest.position_error_m)
    if not search_end.reason:
        return search_end.nearest
    raise UnreachableError(_refusal(search_end, target, sweeps, options.tension_max_N), search_end.nearest)


def tension_slope(follower: Follower, equilibrium: Equilibrium, target: TipTarget) -> float:
    """Return the largest change of a cable's tension per error of the tip, from J+ [N/m].

    J+ is the pseudoinverse of d(tip)/d(tensions), for the target's components, without slack cables.

    Args:
        follower: of equilibria of the body.
        equilibrium: on the target.
        target: of the tip.

    Raises:
        ConvergenceError: the equilibrium is not stable.
    """
    sensitivity = follower.sensitivity(equilibrium)
    rows, _ = target.error(sensitivity.tip)
    pulled = np.array(equilibrium.loads.cable_tension_N) > 0.0
    if not pulled.any():
        return 0.0
    position_rows = rows[rows[:, :3].any(axis=1)]
    tensions_per_error = np.linalg.pinv(position_rows @ sensitivity.to_tension()[:, pulled])
    return float(np.linalg.norm(tensions_per_error, axis=1).max(initial=0.0))


def _stable(follower: Follower, equilibrium: Equilibrium) -> bool:
    try:
        follower.sensitivity(equilibrium)
    except ConvergenceError:
        return False
    return True


def _refusal(
    search_end: SearchEnd, target: TipTarget, sweeps: list[TensionSweep], tension_max_N: float
) -> str:
    nearest = search_end.nearest
    goal = "the target" if target.height is None else f"a height of {target.height:g} m"
    message = (
        f"no cable tensions of 0 to {tension_max_N:g} N found that bring the tip to {goal}; the nearest is "
        f"{nearest.off()} off at {tensions_text(nearest.equilibrium)}: {search_end.reason}"
    )
    if target.height is None:
        lost = dict.fromkeys(sweep.lost for sweep in sweeps if sweep.lost not in message)
        return "; ".join([message, *lost])
    walked = [sweep for sweep in sweeps if sweep.walked]
    heights = [height for sweep in walked for height in sweep.heights]
    if heights and not min(heights) <= target.height <= max(heights):
        message += f"; ask for a height that was reached, {min(heights):.4f} to {max(heights):.4f} m"
    return "; ".join([message, *(sweep.describe() for sweep in walked)])
