"""Implicit steps of a chain of frames, and solutions in which cables have commanded lengths.

Steps follow the schemes of `cosim.soft.solve.time_step` on the frames' points.

Cables of commanded length on a chain: the tensions that the route's length at the solution gives them.

A solution takes tensions. Those of commanded cables are separate unknowns, T_c = k_c f(L_c - L_0c) as
in `cosim.soft.elements.cable`, found by Newton's method around it: with g_c the gradient of
sum_i c_i L_i, m_c that sum over L_c, and H the tangent, a unit of tension d shortens cable c by
g_c^T H^-1 g_d / m_c.
"""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from scipy.linalg import LinAlgError

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.solve import chain_step
from cosim.reduced.solve.clamp import INSTEAD, FrameClamp, check_pressure, place_in_range
from cosim.reduced.solve.newton import ChainSolver, ChainTangent, ChainTask, KeptTangent
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import base_tension, onset
from cosim.soft.solve import newton_options, state

CLOSE_N: Final = 1e-8
"""How closely a chain is solved whose cables have lengths: their tension feels where it ends."""
_ROUNDS_MAX = 30
_TOLERANCE_N = 1e-6


def commanded(loads: Loads) -> tuple[int, ...]:
    """Return which cables have a commanded length."""
    return tuple(c for c, length in enumerate(loads.cable_length_m) if length is not None)


def with_tensions(loads: Loads, tension_N: tuple[float, ...]) -> Loads:
    """Return the loads with tensions in place of commanded lengths."""
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
        chosen, cables = commanded(loads), solver.section.body.cables
        x = solver.section.positions(frames, pressure_Pa)
        slack = with_tensions(loads, (0.0,) * len(cables))
        still = solver.evaluate(frames, slack, pressure_Pa)
        gradient, mean_ratio, stiffness, tension, missing = [], [], [], [], []
        for c in chosen:
            unit = tuple(float(c == d) for d in range(len(cables)))
            gradient.append(solver.evaluate(frames, with_tensions(loads, unit), pressure_Pa) - still)
            cable, lengths = cables[c], cables[c].segment_lengths(x)
            mean_ratio.append(float(cable.tension_ratio(x) @ lengths / lengths.sum()))
            q = loads.cable_stiffening[c] if loads.cable_stiffening else 1.0
            stretch = q * (float(lengths.sum()) - float(loads.cable_length_m[c] or 0.0))
            _, force, slope = onset(stretch)
            stiffness.append(cable.stiffness_N_m * q * slope)
            tension.append(cable.stiffness_N_m * force)
            missing.append(-cable.stiffness_N_m * stretch if force == 0.0 else 0.0)
        figures = (np.array(row) for row in (mean_ratio, stiffness, tension, missing))
        return cls(np.array(gradient), *figures)

    def taut(self, solver: ChainSolver, loads: Loads) -> Array:
        """Return the stiffness (c,) [N/m] with slack cables as taut ones."""
        q = loads.cable_stiffening or (1.0,) * len(loads.cable_length_m)
        whole = np.array([solver.section.body.cables[c].stiffness_N_m * q[c] for c in commanded(loads)])
        return np.where(self.missing_N > 0.0, whole, self.stiffness)


def given_tensions(
    solver: ChainSolver, frames: Array, loads: Loads, pressure_Pa: float
) -> tuple[Loads, Array | None]:
    """Return loads with the tensions of commanded cables at frames (f, 4, 3), and what their change stiffens.

    The latter, sum_c k_c f'_c g_c g_c^T / m_c (6 f, 6 f), is None without commanded cables.
    """
    if not commanded(loads):
        return loads, None
    pulls = Pulls.of(solver, frames, loads, pressure_Pa)
    flat = pulls.gradient.reshape(len(pulls.mean_ratio), -1)
    given = with_tensions(loads, tensions_at(solver, frames, loads, pressure_Pa))
    return given, flat.T @ ((pulls.stiffness / pulls.mean_ratio)[:, None] * flat)


def solve_loaded(
    solver: ChainSolver, task: ChainTask, loads: Loads, start: int | Array, begin_Pa: float
) -> chain_step.ChainStep:
    """Return the solution of a task, at the tensions that commanded cables have in it.

    Args:
        solver: of the chain.
        task: what is to be solved.
        loads: that act.
        start: one of the kernel's, or frames (f, 4, 3).
        begin_Pa: gauge pressure at which the search for that of a sealed gas begins.
    """
    chosen = list(commanded(loads))
    if not chosen:
        return solver.find(task, loads, start, begin_Pa)
    scheme = task.scheme._replace(tolerance_N=min(CLOSE_N, task.scheme.tolerance_N))
    task, free = replace(task, scheme=scheme), task.clamp.free

    def attempt(tension: Array, before: chain_step.ChainStep | None) -> chain_step.ChainStep:
        begin, pressure = (start, begin_Pa) if before is None else (before.frames, before.pressure_Pa)
        return solver.find(task, with_tensions(loads, tuple(tension.tolist())), begin, pressure)

    near = np.asarray(start) if task.begin is None else task.begin.frames
    pressure = begin_Pa if solver.section.gas(loads) is not None else solver.section.pressure(loads)
    tension, spent = np.array(tensions_at(solver, near, loads, pressure)), 0
    found, good, known = attempt(tension, None), None, tension.copy()
    known[chosen] = 0.0  # a chain that its cables pull too far has no equilibrium
    for _ in range(_ROUNDS_MAX):
        spent += found.iterations
        if found.outcome is not newton_options.Outcome.CONVERGED:
            if np.abs(tension - known).max() <= _TOLERANCE_N:
                return replace(found, iterations=spent)
            tension = 0.5 * (tension + known) if good is not None else known
            found = attempt(tension, good)
            continue
        good, known = found, tension
        pulls = Pulls.of(solver, found.frames, loads, found.pressure_Pa)
        off = tension[chosen] - pulls.tension_N
        if np.abs(off).max() <= _TOLERANCE_N:
            return replace(found, iterations=spent)
        given = with_tensions(loads, tuple(tension.tolist()))
        try:
            tangent = ChainTangent(solver, found.frames, free, (given, None), found.pressure_Pa, task.bed)
        except LinAlgError:
            return replace(found, outcome=newton_options.Outcome.INDEFINITE, iterations=spent)
        shortened = np.einsum("cfi,dfi->cd", pulls.gradient, tangent.solve(pulls.gradient))
        # one that is pulled and found slack is on the taut side of the onset's bend, too far
        matrix = np.eye(len(chosen)) + (pulls.taut(solver, loads) / pulls.mean_ratio)[:, None] * shortened
        off, tension = off + pulls.missing_N, tension.copy()
        tension[chosen] = np.maximum(tension[chosen] - np.linalg.solve(matrix, off), 0.0)
        found = attempt(tension, found)
    return replace(found, outcome=newton_options.Outcome.ITERATION_LIMIT, iterations=spent)


@final
class ChainStepper:
    """Steps one chain.

    Args:
        solver: of the chain.
        options: how steps are solved.
    """

    def __init__(self, solver: ChainSolver, options: state.StepOptions) -> None:
        self._solver, self._options = solver, options
        self._two_steps = options.integrator == "bdf2"
        self.tangent = KeptTangent(solver.work)

    @property
    def options(self) -> state.StepOptions:
        """How steps are solved."""
        return self._options

    @property
    def losses_follow_shape(self) -> bool:
        """Whether the tension of a cable's segments hangs on the shape."""
        return self._solver.losses_follow_shape

    def segment_tensions(self, tension_N: Array) -> Array:
        """Return the tension (n, k) [N] of all cable segments from those at the base ends (n, cables)."""
        return self._solver.segment_tensions(tension_N)

    def side(self, clamp: FrameClamp, loads: Loads, frames: Array) -> chain_step.ChainSide:
        """Return chain, loads and workspace for steps that are taken elsewhere; the tensions are a copy.

        Args:
            clamp: frames held by the flange.
            loads: that act in the first of them: given pressure and tensions, dead loads.
            frames: (f, 4, 3), where they begin.
        """
        chain = self._solver.acting(loads, self._solver.section.pressure(loads), frames)
        chain = chain._replace(tension=chain.tension.copy())
        return chain_step.ChainSide(chain, clamp.free, clamp.offsets, self.tangent.work)

    @property
    def tables(self) -> tuple[Array, Array, Array]:
        """Coefficients (size, s c), lengths (size, s) and eyelets (size, 6 k) over the spline of pressure."""
        return (*self._solver.section.tables, self._solver.eyelet_table)

    def scheme(self, step_s: float) -> chain_step.ChainScheme:
        """Return how a step of some length [s] is solved."""
        options = self._options
        losses = options.damping_per_s, options.air_drag_per_s
        limits = options.tolerance_N, self._solver.lever_m
        return chain_step.ChainScheme(step_s, *losses, *limits, options.newton.iterations_max)

    def task(
        self, chain: chain_step.ChainState, clamp: FrameClamp, step_s: float, flange: Pose | None = None
    ) -> ChainTask:
        """Return a step of some length [s] from a chain, with a pose of the flange at its end."""
        pose, two_steps = flange or Pose(), self._two_steps and chain.earlier is not None
        axes = np.vstack([pose.translation, pose.rotation.T])
        return ChainTask(clamp, self.scheme(step_s), chain, two_steps, axes, self.tangent)

    def step(
        self, task: ChainTask, loads: Loads, begin_Pa: float = 0.0, aim: state.StepAim | None = None
    ) -> chain_step.ChainStep:
        """Advance by one step.

        Args:
            task: of `task`.
            loads: at the end.
            begin_Pa: gauge pressure at the beginning, with sealed gas.
            aim: how closely; `start` is of frames (f, 4, 3). As an ordinary step unless given.

        Raises:
            ConvergenceError: no solution; the caller still holds the chain.
        """
        # free flight is the best start, unless it leaves the range of the model
        starts: list[int | Array] = [chain_step.FREE_FLIGHT, chain_step.STANDING, chain_step.CARRIED]
        if aim is not None and aim.start is not None:
            starts.insert(0, aim.start)
        for start in starts:
            found = solve_loaded(self._solver, task, loads, start, begin_Pa)
            if found.outcome is not newton_options.Outcome.NOT_FINITE:
                break
        if found.outcome is not newton_options.Outcome.CONVERGED:
            assert task.begin is not None
            raise self._failure(found, task.begin)
        check_pressure(self._solver.section, found.pressure_Pa, found.residual_N, found.iterations)
        if aim is not None and found.residual_N > aim.tolerance_N:
            # below an ordinary step's tolerance rounding may leave no descent
            _, fine = aim.newton(self._options)
            closely = task.scheme._replace(tolerance_N=fine.tolerance_N, iterations_max=fine.iterations_max)
            task = replace(task, scheme=closely)
            closer = solve_loaded(self._solver, task, loads, found.frames, found.pressure_Pa)
            if closer.residual_N <= found.residual_N:
                found = replace(closer, iterations=found.iterations + closer.iterations)
        return found

    def _failure(self, found: chain_step.ChainStep, begin: chain_step.ChainState) -> ConvergenceError:
        """Return the error of a step that was not found: its model ends, or it has no other name."""
        section, text = self._solver.section, f"the soft step did not converge: {found.outcome.value}"
        ends = (place_in_range(section, x, found.pressure_Pa) for x in (found.frames, begin.frames))
        end = max(ends, key=lambda place: place.fraction)
        if end.at_its_end:
            text = f"the section model ends here: {end.text}; {INSTEAD}"
        text += f"; residual {found.residual_N:.3g} N after {found.iterations} iterations"
        if end.at_its_end:
            return OutOfRangeError(text, found.residual_N, found.iterations, end.text)
        return ConvergenceError(text, found.residual_N, found.iterations)
