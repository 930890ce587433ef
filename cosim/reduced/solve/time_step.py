"""Implicit steps of a chain of frames, by the scheme of `cosim.soft.solve.state` on the frames' points."""

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
        options: how steps are solved.
    """

    def __init__(self, solver: ChainSolver, options: StepOptions) -> None:
        self._solver, self._options = solver, options
        self.factor = ReusedFactor(solver.work)
        self._schemes: dict[tuple[float, bool], ChainScheme] = {}

    def scheme(self, step_s: float, *, first: bool) -> ChainScheme:
        """Return how a step of some length [s] is solved; `first`: without a step before it."""
        known = self._schemes.get((step_s, first))
        if known is None:
            options, coefficients = self._options, self._options.coefficients(step_s, first=first)
            inertia = inertia_weight(coefficients.span, options.losses_per_s)
            limits = options.tolerance_N, self._solver.lever_m, options.newton.iterations_max
            known = self._schemes[step_s, first] = ChainScheme(step_s, coefficients, inertia, *limits)
        return known

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
            accuracy: how closely; `start` is of frames (f, 4, 3). As an ordinary step unless given.

        Raises:
            ConvergenceError: no solution; the caller still holds the chain.
        """
        begin = task.begin
        assert begin is not None, "a step begins somewhere"
        for start in _STARTS if accuracy is None or accuracy.start is None else (accuracy.start, *_STARTS):
            found = solve_loaded(self._solver, task, loads, start, begin.pressure_Pa)
            if found.outcome is not Outcome.NOT_FINITE:
                break
        if found.outcome is not Outcome.CONVERGED:
            raise self._failure(found, begin)
        check_pressure(self._solver.section, found.pressure_Pa, found.residual_N, found.iterations)
        if accuracy is not None and found.residual_N > accuracy.tolerance_N:
            return self._closer(task, loads, accuracy, found)
        return found

    def _closer(self, task: ChainTask, loads: Loads, accuracy: StepAccuracy, found: ChainStep) -> ChainStep:
        """Return a step solved as closely as asked for, or as it was found: rounding may leave no descent."""
        _, fine = accuracy.newton(self._options)
        scheme = task.scheme._replace(tolerance_N=fine.tolerance_N, iterations_max=fine.iterations_max)
        task = task._replace(scheme=scheme)
        closer = solve_loaded(self._solver, task, loads, found.frames, found.pressure_Pa)
        if closer.residual_N <= found.residual_N:
            return replace(closer, iterations=found.iterations + closer.iterations)
        return found

    def _failure(self, found: ChainStep, begin: ChainState) -> ConvergenceError:
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
