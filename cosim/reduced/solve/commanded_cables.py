"""Cables of commanded length on a chain: tensions that agree with the length of the route at the solution.

The solver needs tensions. Those of commanded cables are separate unknowns, T_c = k_c f(L_c - L_0c) as
in `cosim.soft.elements.cable`, found by Newton's method around it: with g_c the gradient of
sum_i c_i L_i, m_c that sum over L_c, and H the tangent, a unit of tension d shortens cable c by
g_c^T H^-1 g_d / m_c.
"""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.reduced.solve.chain_solver import ChainSolver, ChainTask
from cosim.reduced.solve.chain_step import ChainStep
from cosim.reduced.solve.tangent import ChainPoint, ChainTangent, HeldLengths, TangentError
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import base_tension, onset
from cosim.soft.solve.newton_options import Outcome

CLOSE_N: Final = 1e-8
"""Residual of a chain with cables of commanded length, whose tensions are sensitive to its shape."""
_ROUNDS_MAX = 30
_TOLERANCE_N = 1e-6


def commanded(loads: Loads) -> tuple[int, ...]:
    """Return which cables have a commanded length."""
    return tuple(c for c, length in enumerate(loads.cable_length_m) if length is not None)


def with_tensions(loads: Loads, tension_N: tuple[float, ...]) -> Loads:
    """Return the loads with tensions instead of commanded lengths."""
    return replace(loads, cable_tension_N=tension_N, cable_length_m=())


def tensions_at(solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float) -> tuple[float, ...]:
    """Return the tension [N] of every cable at frames (f, 4, 3), given or from the route's length."""
    chosen = commanded(loads)
    if not chosen:
        return loads.cable_tension_N
    tension, x = list(loads.cable_tension_N), solver.section.positions(frames, pressure_Pa)
    cables, q = solver.section.body.cables, loads.cable_stiffening or (1.0,) * len(tension)
    for c in chosen:
        tension[c] = base_tension(cables[c], x, float(loads.cable_length_m[c] or 0.0), q[c])
    return tuple(tension)


@final
@dataclass(frozen=True)
class Pulls:
    """Commanded cables at one shape.

    Args:
        gradient: (c, f, 6) of sum_i c_i L_i [1, m].
        mean_ratio: (c,), m: that sum over the length.
        stiffness: (c,) [N/m], k f'.
        tension_N: (c,) k f(L - L_0).
        missing_N: (c,) k (L_0 - L) of a slack cable, 0 of a taut one.
    """

    gradient: Array
    mean_ratio: Array
    stiffness: Array
    tension_N: Array
    missing_N: Array

    @classmethod
    def of(cls, solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float) -> "Pulls":
        """Return the commanded cables of some loads at frames (f, 4, 3)."""
        commanded_cables, cables = commanded(loads), solver.section.body.cables
        x = solver.section.positions(frames, pressure_Pa)
        slack = with_tensions(loads, (0.0,) * len(cables))
        slack_gradient = solver.evaluate(frames, slack, pressure_Pa)
        gradient, mean_ratio, stiffness, tension, missing = [], [], [], [], []
        for c in commanded_cables:
            unit = tuple(float(c == d) for d in range(len(cables)))
            gradient.append(solver.evaluate(frames, with_tensions(loads, unit), pressure_Pa) - slack_gradient)
            cable, lengths = cables[c], cables[c].segment_lengths(x)
            mean_ratio.append(float(cable.tension_ratio(x) @ lengths / lengths.sum()))
            q = loads.cable_stiffening[c] if loads.cable_stiffening else 1.0
            stretch = q * (float(lengths.sum()) - float(loads.cable_length_m[c] or 0.0))
            _, force, slope = onset(stretch)
            stiffness.append(cable.stiffness_N_m * q * slope)
            tension.append(cable.stiffness_N_m * force)
            missing.append(-cable.stiffness_N_m * stretch if force == 0.0 else 0.0)
        figures = (np.array(values) for values in (mean_ratio, stiffness, tension, missing))
        return cls(np.array(gradient), *figures)

    def taut(self, solver: ChainSolver, loads: Loads) -> Array:
        """Return the stiffness (c,) [N/m] with slack cables as taut ones."""
        q = loads.cable_stiffening or (1.0,) * len(loads.cable_length_m)
        taut_stiffness = np.array(
            [solver.section.body.cables[c].stiffness_N_m * q[c] for c in commanded(loads)]
        )
        return np.where(self.missing_N > 0.0, taut_stiffness, self.stiffness)


def point_of(solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float) -> ChainPoint:
    """Return frames (f, 4, 3) under loads, at the tensions that commanded cables have there."""
    if not commanded(loads):
        return ChainPoint(frames, loads, pressure_Pa)
    pulls = Pulls.of(solver, frames, loads, pressure_Pa)
    flat = pulls.gradient.reshape(len(pulls.mean_ratio), -1)
    pulled = with_tensions(loads, tensions_at(solver, frames, loads, pressure_Pa))
    return ChainPoint(frames, pulled, pressure_Pa, HeldLengths(flat, pulls.stiffness / pulls.mean_ratio))


def solve_loaded(
    solver: ChainSolver, task: ChainTask, loads: Loads, start: int | Array, begin_Pa: float
) -> ChainStep:
    """Solve a chain with cables of commanded length, at consistent tensions.

    Args:
        solver: of the chain.
        task: options, clamp and scheme of the solution.
        loads: active loads.
        start: a start of `chain_step`, such as STANDING, or frames (f, 4, 3).
        begin_Pa: gauge pressure at which the search for the pressure of a sealed gas begins.
    """
    chosen = list(commanded(loads)) if loads.cable_length_m else []
    if not chosen:
        return solver.find(task, loads, start, begin_Pa)
    scheme = task.scheme._replace(tolerance_N=min(CLOSE_N, task.scheme.tolerance_N))
    task, free = task._replace(scheme=scheme), task.clamp.free

    def attempt(tension: Array, before: ChainStep | None) -> ChainStep:
        begin, pressure = (start, begin_Pa) if before is None else (before.frames, before.pressure_Pa)
        return solver.find(task, with_tensions(loads, tuple(tension.tolist())), begin, pressure)

    near = np.asarray(start) if task.begin is None else task.begin.frames
    pressure = begin_Pa if solver.section.gas(loads) is not None else solver.section.pressure(loads)
    tension, total = np.array(tensions_at(solver, near, loads, pressure)), 0
    solution, converged, converged_N = attempt(tension, None), None, tension.copy()
    converged_N[chosen] = 0.0  # a chain that its cables pull too far has no equilibrium
    for _ in range(_ROUNDS_MAX):
        total += solution.iterations
        if solution.outcome is not Outcome.CONVERGED:
            if np.abs(tension - converged_N).max() <= _TOLERANCE_N:
                return replace(solution, iterations=total)
            tension = 0.5 * (tension + converged_N) if converged is not None else converged_N
            solution = attempt(tension, converged)
            continue
        converged, converged_N = solution, tension
        pulls = Pulls.of(solver, solution.frames, loads, solution.pressure_Pa)
        difference = tension[chosen] - pulls.tension_N
        if np.abs(difference).max() <= _TOLERANCE_N:
            return replace(solution, iterations=total)
        pulled = with_tensions(loads, tuple(tension.tolist()))
        try:
            point = ChainPoint(solution.frames, pulled, solution.pressure_Pa)
            tangent = ChainTangent(solver, point, free, task.inertia)
        except TangentError:
            return replace(solution, outcome=Outcome.INDEFINITE, iterations=total)
        shortened = np.einsum("cfi,dfi->cd", pulls.gradient, tangent.solve(pulls.gradient))
        # a pulled cable whose route is slack at the solution is on the taut side of the onset, too far
        matrix = np.eye(len(chosen)) + (pulls.taut(solver, loads) / pulls.mean_ratio)[:, None] * shortened
        difference, tension = difference + pulls.missing_N, tension.copy()
        tension[chosen] = np.maximum(tension[chosen] - np.linalg.solve(matrix, difference), 0.0)
        solution = attempt(tension, solution)
    return replace(solution, outcome=Outcome.ITERATION_LIMIT, iterations=total)
