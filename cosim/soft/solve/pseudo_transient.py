"""Pseudo-transient continuation: equilibria that Newton's method does not reach, by damped steps that grow.

Each step minimises potential + c |x - x_n|^2 / 2, an implicit step of a body without mass in a viscous bath:
c = drag / pseudo time. c falls while steps succeed, so that the shape slides from where a branch of
equilibria ends to the next stable one, where Newton's method proper takes over: what is found is an
equilibrium of the body alone.
Source: Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.loads import Loads
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome, SearchEffort

_BED_N_m = 1e3  # c of the first step
_FALL, _RISE = 0.4, 6.0
_LEAST_BED_N_m, _LARGEST_BED_N_m = 1e-3, 1e7
_PROPER_BELOW_N_m = 10.0  # where Newton's method proper is tried
_ITERATIONS_MAX = 12  # of a step
_STEPS_MAX = 150
_LOST_MAX = 400  # iterations that moved nothing, before a slide is given up


def slide(
    solver: NewtonSolver,
    start: Array,
    memory: Array,
    loads_at: Callable[[Array], Loads],
    options: NewtonOptions,
    effort: SearchEffort,
) -> NewtonResult:
    """Return the equilibrium that a damped body slides to, or how far it got.

    Args:
        solver: Newton's method for the body.
        start: (n, 3) [m], clamped components where they shall be.
        memory: (values,), what the elements remember of the last accepted state.
        loads_at: positions (n, 3) [m] -> loads, with what is touched near them.
        options: bounds of Newton's method.
        effort: counts the iterations.

    Raises:
        ConvergenceError: the search took all the iterations that it may.
    """
    options = replace(options, reuse_max=0)
    step = replace(options, iterations_max=min(_ITERATIONS_MAX, options.iterations_max))
    bed, x, spent, lost, shifted = _BED_N_m, start, 0, 0, 0
    moved, softer, rests = np.inf, False, False
    found: NewtonResult | None = None
    for _ in range(_STEPS_MAX):
        loads, bounded = loads_at(x), effort.bounded(step)
        tried = solver.solve(x, memory, loads, bounded, Inertia(np.full(len(x), bed), x))
        effort.spend(tried)
        spent, shifted = spent + tried.iterations, shifted + tried.shifted
        if tried.outcome is Outcome.NOT_FINITE or tried.outcome is Outcome.INDEFINITE:
            bed *= _RISE
            lost += tried.iterations
        else:
            before, moved = moved, float(np.abs(tried.positions - x).max())
            rests, softer = softer and moved <= before, tried.converged
            x, memory = tried.positions, tried.memory
            bed *= _FALL if tried.converged else _RISE
        # beyond the end of a branch steps grow as the bed softens: no equilibrium is near yet
        if tried.converged and bed < _PROPER_BELOW_N_m and rests:
            found = solver.solve(x, memory, loads, effort.bounded(options))
            effort.spend(found)
            spent, shifted = spent + found.iterations, shifted + found.shifted
            if found.converged:
                break
            lost += found.iterations
        bed = max(bed, _LEAST_BED_N_m)
        if bed > _LARGEST_BED_N_m or lost >= _LOST_MAX:
            break
    if found is None:
        found = solver.solve(x, memory, loads_at(x), effort.bounded(options))
        effort.spend(found)
        spent, shifted = spent + found.iterations, shifted + found.shifted
    return replace(found, iterations=spent, shifted=shifted)
