"""Implicit steps of a chain of frames, by `cosim.soft.solve.step_scheme` on the frames' points."""

from dataclasses import replace
from typing import final

from cosim.base.frames import Pose
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.solve.chain_solver import ChainSolver, ChainTask
from cosim.reduced.solve.chain_step import CARRIED, FREE_FLIGHT, STANDING, ChainScheme, ChainState, ChainStep
from cosim.reduced.solve.clamp import FrameClamp
from cosim.reduced.solve.commanded_cables import solve_loaded
from cosim.reduced.solve.reused_factor import ReusedFactor
from cosim.reduced.solve.working_range import INSTEAD, check_pressure, place_in_range
from cosim.soft.body.loads import Loads
from cosim.soft.solve.clamp import flange_axes
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.step_scheme import StepAccuracy, StepOptions, inertia_weight

_STARTS = FREE_FLIGHT, STANDING, CARRIED
"""Free flight is the best start, unless it leaves the range of the model."""


@final
class ChainStepper:
    """Steps one chain; `factor` is the one that the next step may reuse.

    Args:
        solver: of the chain.
        options: tolerances and damping of steps.
    """

    def __init__(self, solver: ChainSolver, options: StepOptions) -> None:
        self._solver, self._options = solver, options
        self.factor = ReusedFactor(solver.work)
        self._schemes: dict[tuple[float, bool], ChainScheme] = {}

    def scheme(self, step_s: float, *, first: bool) -> ChainScheme:
        """Return the scheme of a step of some length [s]; `first`: without a step before it."""
        scheme = self._schemes.get((step_s, first))
        if scheme is None:
            options, coefficients = self._options, self._options.coefficients(step_s, first=first)
            inertia = inertia_weight(coefficients.span, options.losses_per_s)
            limits = options.tolerance_N, self._solver.lever_m, options.newton.iterations_max
            scheme = self._schemes[step_s, first] = ChainScheme(step_s, coefficients, inertia, *limits)
        return scheme

    def task(
        self, chain: ChainState, clamp: FrameClamp, step_s: float, flange: Pose | None = None
    ) -> ChainTask:
        """Return a step of some length [s] from a chain, with a pose of the flange at its end."""
        scheme = self.scheme(step_s, first=chain.earlier is None)
        return ChainTask(clamp, scheme, chain, flange_axes(flange or Pose()), self.factor)

    def step(self, task: ChainTask, loads: Loads, accuracy: StepAccuracy | None = None) -> ChainStep:
        """Advance by one step.

        Args:
            task: of `task`.
            loads: at the end.
            accuracy: tolerance and start, frames (f, 4, 3); None for those of an ordinary step.

        Raises:
            ConvergenceError: no solution; `task.begin` is unchanged.
        """
        begin = task.begin
        assert begin is not None, "a step begins somewhere"
        for start in _STARTS if accuracy is None or accuracy.start is None else (accuracy.start, *_STARTS):
            solution = solve_loaded(self._solver, task, loads, start, begin.pressure_Pa)
            if solution.outcome is not Outcome.NOT_FINITE:
                break
        if solution.outcome is not Outcome.CONVERGED:
            raise self._failure(solution, begin)
        check_pressure(self._solver.section, solution.pressure_Pa, solution.residual_N, solution.iterations)
        if accuracy is not None and solution.residual_N > accuracy.tolerance_N:
            return self._closer(task, loads, accuracy, solution)
        return solution

    def _closer(self, task: ChainTask, loads: Loads, accuracy: StepAccuracy, first: ChainStep) -> ChainStep:
        """Return a step within the tolerance of `accuracy`, or `first` if rounding permits no better one."""
        _, fine = accuracy.newton(self._options)
        scheme = task.scheme._replace(tolerance_N=fine.tolerance_N, iterations_max=fine.iterations_max)
        task = task._replace(scheme=scheme)
        closer = solve_loaded(self._solver, task, loads, first.frames, first.pressure_Pa)
        if closer.residual_N <= first.residual_N:
            return replace(closer, iterations=first.iterations + closer.iterations)
        return first

    def _failure(self, solution: ChainStep, begin: ChainState) -> ConvergenceError:
        """Return the error of a step without solution: the end of the model's range, or no convergence."""
        section, text = self._solver.section, f"the soft step did not converge: {solution.outcome.value}"
        ends = (place_in_range(section, x, solution.pressure_Pa) for x in (solution.frames, begin.frames))
        end = max(ends, key=lambda in_range: in_range.fraction)
        if end.at_its_end:
            text = f"the section model ends here: {end.text}; {INSTEAD}"
        text += f"; residual {solution.residual_N:.3g} N after {solution.iterations} iterations"
        if end.at_its_end:
            return OutOfRangeError(text, solution.residual_N, solution.iterations, end.text)
        return ConvergenceError(text, solution.residual_N, solution.iterations)
