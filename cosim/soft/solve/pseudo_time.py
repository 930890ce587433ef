"""Pseudo-transient continuation: equilibria far away, reached by damped steps that grow.

Each step minimises potential + c |x - x_n|^2 / 2, an implicit step of a massless body in a viscous bath with
c = drag / pseudo time. c falls while steps succeed, so the shape slides from the end of a branch of
equilibria to the next stable equilibrium. There the plain Newton method takes over, so that the result is an
equilibrium of the body alone.
Source: Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.loads import Loads
from cosim.soft.film.inertia import Inertia
from cosim.soft.solve import newton
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome
from cosim.soft.solve.search_effort import SearchEffort

_FIRST_N_m = 1e3  # c of the first step
_FALL, _RISE = 0.4, 6.0
_LEAST_N_m, _LARGEST_N_m = 1e-3, 1e7
_PLAIN_BELOW_N_m = 10.0  # c below which the plain Newton method is tried
_ITERATIONS_MAX = 12  # of a step
_STEPS_MAX = 150
_FAILED_MAX = 400  # iterations of failed steps before the slide fails
_LESS = 0.5  # reduction of the residual that restarts the count of patience, see `SearchEffort`


def slide(
    solver: newton.NewtonSolver,
    start: Array,
    memory: Array,
    loads_at: Callable[[Array], Loads],
    options: NewtonOptions,
    effort: SearchEffort,
) -> NewtonResult:
    """Return the equilibrium that a damped body slides to; not converged if the slide fails.

    Args:
        solver: Newton's method for the body.
        start: (n, 3) [m], with clamped components at their prescribed positions.
        memory: (values,), internal variables of the elements at the last accepted state.
        loads_at: positions (n, 3) [m] -> loads, with possible contacts near them.
        options: bounds of Newton's method.
        effort: counts the iterations.

    Raises:
        ConvergenceError: the search reached its bound of iterations.
    """
    options = replace(options, reuse_max=0)
    step = replace(options, iterations_max=min(_ITERATIONS_MAX, options.iterations_max))
    proximal_N_m, x, iterations, failed, shifted = _FIRST_N_m, start, 0, 0, 0
    largest_m, reduced, slows = np.inf, False, False
    least_N, improved_at = np.inf, 0
    solution: NewtonResult | None = None
    for _ in range(_STEPS_MAX):
        loads, bounded = loads_at(x), effort.bounded(step)
        trial = solver.solve(x, memory, loads, bounded, Inertia(np.full(len(x), proximal_N_m), x))
        effort.spend(trial)
        iterations, shifted = iterations + trial.iterations, shifted + trial.shifted
        if trial.outcome is Outcome.INDEFINITE and not trial.iterations:
            break  # shifts larger than any c were tried
        if trial.outcome is Outcome.NOT_FINITE or trial.outcome is Outcome.INDEFINITE:
            proximal_N_m *= _RISE
            failed += trial.iterations
        else:
            before, largest_m = largest_m, float(np.abs(trial.positions - x).max())
            slows, reduced = reduced and largest_m <= before, trial.converged
            x, memory = trial.positions, trial.memory
            residual_N = proximal_N_m * largest_m  # residual without the proximal term
            if trial.converged and residual_N < _LESS * least_N:
                least_N, improved_at = residual_N, iterations
            proximal_N_m *= _FALL if trial.converged else _RISE
        # beyond the end of a branch steps grow as c falls: no equilibrium is near yet
        if trial.converged and proximal_N_m < _PLAIN_BELOW_N_m and slows:
            solution = solver.solve(x, memory, loads, effort.bounded(options))
            effort.spend(solution)
            iterations, shifted = iterations + solution.iterations, shifted + solution.shifted
            if solution.converged:
                break
            failed += solution.iterations
        proximal_N_m = max(proximal_N_m, _LEAST_N_m)
        if (
            proximal_N_m > _LARGEST_N_m
            or failed >= _FAILED_MAX
            or iterations - improved_at >= effort.patience
        ):
            break
    if solution is None:
        solution = solver.solve(x, memory, loads_at(x), effort.bounded(options))
        effort.spend(solution)
        iterations, shifted = iterations + solution.iterations, shifted + solution.shifted
    return replace(solution, iterations=iterations, shifted=shifted)
