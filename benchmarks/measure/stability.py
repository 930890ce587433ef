"""Is an equilibrium a minimum of the potential, and which lower one lies beside it?

Several wrinkled equilibria coexist at one pressure. The number of negative pivots of the tangent is the
number of directions in which the potential falls (Sylvester's law of inertia); a minimum has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from cosim.base.frames import Array
from cosim.errors import ConvergenceError
from cosim.soft.linear.linear_solver import by_component
from cosim.soft.linear.low_rank import negative_added
from cosim.soft.published.general_lu import GeneralLU
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Equilibrium, SoftState


def negative_pivots(solver: NewtonSolver, equilibrium: Equilibrium) -> int:
    """Return how many negative eigenvalues the tangent stiffness of the free components has.

    LU with a symmetric ordering and pivots from the diagonal gives S = L D L^T; the signs of D count. Dense
    terms (sealed gas, cables of commanded length) are counted by `low_rank.negative_added`.

    Args:
        solver: Newton's method for the body with the clamp in force.
        equilibrium: where the tangent is taken.
    """
    system = solver.system
    sparse = _tangent(solver, equilibrium)
    factor = splu(sparse, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    count = int((factor.U.diagonal() < 0.0).sum())
    if system.low_rank is None:
        return count
    free = np.flatnonzero(by_component(solver.free).ravel())

    def solve(loads: Array) -> Array:
        answers = np.zeros((len(loads), system.gradient.size))
        answers[:, free] = factor.solve(loads.reshape(len(loads), -1)[:, free].T).T
        return answers.reshape(loads.shape)

    return count + negative_added(system.low_rank, solve)


def _tangent(solver: NewtonSolver, equilibrium: Equilibrium) -> csc_matrix:
    system, state, loads = solver.system, equilibrium.state, equilibrium.loads
    tension = system.segment_share(state.positions, loads)
    system.evaluate(state.positions, loads, tension, state.memory)
    return GeneralLU(system.tangent_pattern, solver.free).matrix(system.tangent_blocks)


@final
@dataclass(frozen=True)
class PerturbationOptions:
    """How a lower state is looked for.

    Args:
        amplitude_m: root mean square of the displacement that a node is given.
        trials: perturbations tried besides the drawn shape; the lowest state found is kept.
        random_seed: of the perturbations; equal seeds give equal states.
    """

    amplitude_m: float = 5e-4
    trials: int = 4
    random_seed: int = 0


def find_lower_state(
    solver: EquilibriumSolver, begin: Equilibrium, options: PerturbationOptions | None = None
) -> Equilibrium:
    """Return the equilibrium of lowest potential found by perturbing one; the same one if none is lower.

    Newton's method with inertia correction goes down the potential, so that each start ends in a state
    that is no higher. Starts are the drawn shape, from where one large step often finds another pattern of
    wrinkles than many small ones, and random perturbations of the best state so far.

    Args:
        solver: follows equilibria of the body.
        begin: where to start; flange and loads stay.
        options: of the search.
    """
    options = options or PerturbationOptions()
    rng = np.random.default_rng(options.random_seed)
    best = begin
    drawn = SoftState.drawn(solver.solver.system.body, begin.world_from_flange)
    for trial in range(options.trials + 1):
        state, start = best.state, drawn.positions
        if trial == 0:
            state = drawn
        else:
            nudge = options.amplitude_m * rng.standard_normal(begin.state.positions.shape)
            start = best.state.positions + nudge * by_component(solver.solver.free)
        try:
            found = solver.solve(state, best.world_from_flange, best.loads, start)
        except ConvergenceError:
            continue
        if found.potential_J < best.potential_J - 1e-9 * (1.0 + abs(best.potential_J)):
            best = found
    return best
