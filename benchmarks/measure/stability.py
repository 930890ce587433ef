"""Is an equilibrium a minimum of the potential, and which lower one lies beside it?

Several wrinkled equilibria coexist at one pressure. The number of negative pivots of the tangent is the
number of directions in which the potential falls (Sylvester's law of inertia); a minimum has none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, final
from unittest import mock

import numpy as np

import cosim
from cosim.coupling.robots.beam_robot import BeamRobot
from cosim.errors import ConvergenceError, CosimError
from cosim.soft.linear.linear_solver import by_component
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Equilibrium, SoftState


def negative_pivots(solver: NewtonSolver, equilibrium: Equilibrium) -> int:
    """Return how many negative eigenvalues the tangent stiffness of the free components has.

    Args:
        solver: Newton's method for the body with the clamp in force.
        equilibrium: where the tangent is taken.
    """
    state = equilibrium.state
    return solver.negative_pivots(state.positions, state.memory, equilibrium.loads)


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
    drawn = SoftState.drawn(solver.solver.film.body, begin.world_from_flange)
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


@contextmanager
def tallied() -> Iterator[Counter[str]]:
    """Count the static solutions that are accepted meanwhile, by what is known of them.

    Each one that is followed, in planning, at the start or in an increment, passes through `switch_branch`.
    """
    found = Counter[str]()

    def counting(switch_branch: Any) -> Any:
        def left(side: Any, begin: Any, end: Any) -> Any:
            here = switch_branch(side, begin, end)
            found[{None: "not known", 0: "stable"}.get(here.negative_pivots, "unstable")] += 1
            return here

        return left

    classes, name = (EquilibriumSolver, BeamRobot), "switch_branch"
    first, second = (mock.patch.object(each, name, counting(getattr(each, name))) for each in classes)
    with first, second:
        yield found


def static_table(names: Sequence[str] = ()) -> int:
    """Take all static solutions of scenarios, print a line on each; return how many are unstable.

    Without names they are those of all shipped ones.

    A quasi-static scenario is run to its end; of one in time, its plan and its start are solved.
    """
    total = Counter[str]()
    print("| scenario | mode | stable | unstable | not known |\n|---|---|---:|---:|---:|")
    for name in names or cosim.list_scenarios():
        with tallied() as found:
            try:
                simulation = cosim.Simulation(name)
                mode = str(simulation.scenario.mode)
                if mode == "quasistatic" and simulation.ticks_left:
                    simulation.step(ticks=simulation.ticks_left)
            except CosimError as error:
                mode = f"ended: {error}"
        counts = " | ".join(f"{found[kind]:,}" for kind in ("stable", "unstable", "not known"))
        print(f"| {name} | {mode} | {counts} |", flush=True)
        total += found
    counts = f"{total['stable']:,} of {total.total():,} static solutions are stable"
    print(f"{counts}, {total['unstable']:,} unstable")
    return total["unstable"]
