"""Implicit steps of a chain of frames: the schemes of `cosim.soft.solve.time_step` on the frames' points."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.solve.chain_step import (
    CARRIED,
    FREE_FLIGHT,
    STANDING,
    ChainScheme,
    ChainSide,
    ChainState,
    ChainStep,
    KeptTangent,
)
from cosim.reduced.solve.clamp import FrameClamp, check_pressure, place_in_range
from cosim.reduced.solve.commanded_cables import solve_loaded
from cosim.reduced.solve.newton import ChainSolver, ChainTask
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.state import StepAim, StepOptions


@final
class ChainStepper:
    """Steps one chain.

    Args:
        solver: of the chain.
        options: how steps are solved.
    """

    def __init__(self, solver: ChainSolver, options: StepOptions) -> None:
        self._solver, self._options = solver, options
        self._two_steps = options.integrator == "bdf2"
        self.tangent = KeptTangent(solver.work)

    @property
    def options(self) -> StepOptions:
        """How steps are solved."""
        return self._options

    @property
    def losses_follow_shape(self) -> bool:
        """Whether the tension of a cable's segments hangs on the shape."""
        return self._solver.losses_follow_shape

    def segment_tensions(self, tension_N: Array) -> Array:
        """Return the tension (n, k) [N] of all cable segments from those at the base ends (n, cables)."""
        return self._solver.segment_tensions(tension_N)

    def side(self, clamp: FrameClamp, loads: Loads, frames: Array) -> ChainSide:
        """Return chain, loads and workspace for steps that are taken elsewhere; the tensions are a copy.

        Args:
            clamp: frames held by the flange.
            loads: that act in the first of them: given pressure and tensions, dead loads.
            frames: (f, 4, 3), where they begin.
        """
        chain = self._solver.acting(loads, loads.pressures(1)[0], frames)
        chain = chain._replace(tension=chain.tension.copy())
        return ChainSide(chain, clamp.free, clamp.offsets, self.tangent.work)

    @property
    def tables(self) -> tuple[Array, Array, Array]:
        """Coefficients (size, s c), lengths (size, s) and eyelets (size, 6 k) over the spline of pressure."""
        return (*self._solver.section.tables, self._solver.eyelet_table)

    def scheme(self, step_s: float) -> ChainScheme:
        """Return how a step of some length [s] is solved."""
        options = self._options
        found = options.damping_per_s, options.tolerance_N, self._solver.lever_m
        return ChainScheme(step_s, *found, options.newton.iterations_max)

    def task(
        self, chain: ChainState, clamp: FrameClamp, step_s: float, flange: Pose | None = None
    ) -> ChainTask:
        """Return a step of some length [s] from a chain, with a pose of the flange at its end."""
        pose, two_steps = flange or Pose(), self._two_steps and chain.earlier is not None
        axes = np.vstack([pose.translation, pose.rotation.T])
        return ChainTask(clamp, self.scheme(step_s), chain, two_steps, axes, self.tangent)

    def step(
        self, task: ChainTask, loads: Loads, begin_Pa: float = 0.0, aim: StepAim | None = None
    ) -> ChainStep:
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
        starts: list[int | Array] = [FREE_FLIGHT, STANDING, CARRIED]
        if aim is not None and aim.start is not None:
            starts.insert(0, aim.start)
        for start in starts:
            found = solve_loaded(self._solver, task, loads, start, begin_Pa)
            if found.outcome is not Outcome.NOT_FINITE:
                break
        if found.outcome is not Outcome.CONVERGED:
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

    def _failure(self, found: ChainStep, begin: ChainState) -> ConvergenceError:
        """Return the error of a step that was not found: its model ends, or it has no other name."""
        section, text = self._solver.section, f"the soft step did not converge: {found.outcome.value}"
        ends = (place_in_range(section, x, found.pressure_Pa) for x in (found.frames, begin.frames))
        end = max(ends, key=lambda place: place.fraction)
        if end.at_its_end:
            text = f"the section model ends here: {end.text}; fidelity = 'lumped' knows what lies beyond"
        text += f"; residual {found.residual_N:.3g} N after {found.iterations} iterations"
        if end.at_its_end:
            return OutOfRangeError(text, found.residual_N, found.iterations, end.text)
        return ConvergenceError(text, found.residual_N, found.iterations)
