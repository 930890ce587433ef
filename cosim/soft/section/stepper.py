"""Implicit steps of a chain of frames: the schemes of `cosim.soft.dynamics` on the frames' points."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import final

from cosim.errors import ConvergenceError
from cosim.frames import Array, Pose
from cosim.soft.body import Loads
from cosim.soft.dynamics import StepAim, StepOptions, difference_scheme
from cosim.soft.newton import Outcome
from cosim.soft.section.frame_clamp import FrameClamp
from cosim.soft.section.solver import Bed, ChainResult, ChainSolver
from cosim.soft.section.stepping import carried, changed, pose_of_points, twists
from cosim.soft.state import SoftState


@final
class ChainStepper:
    """Steps one chain.

    Args:
        solver: of the chain.
        options: how steps are solved.
    """

    def __init__(self, solver: ChainSolver, options: StepOptions) -> None:
        self._solver, self._options = solver, options

    def step(
        self,
        chain: SoftState,
        clamp: FrameClamp,
        flange: Pose,
        loads: Loads,
        step_s: float,
        aim: StepAim | None = None,
    ) -> tuple[SoftState, ChainResult]:
        """Advance by one step, with the flange at its new pose.

        Args:
            chain: at the beginning.
            clamp: frames held by the flange.
            flange: its pose at the end.
            loads: at the end.
            step_s: h [s].
            aim: how closely; `start` is of frames (f, 4, 3). As an ordinary step unless given.

        Raises:
            ConvergenceError: no solution; the caller still holds `chain`.
        """
        options, x = self._options, chain.positions
        base, span, speed = difference_scheme(options.integrator, chain, step_s)
        damped = 1.0 + options.damping_per_s * span
        bed = Bed(damped / span**2, base + span / damped * speed)
        starts = _starts(chain, flange, step_s)
        if aim is not None and aim.start is not None:
            starts = itertools.chain([aim.start], starts)
        for start in starts:
            start = clamp.place(start, flange)
            found = self._solver.solve(
                start, clamp.free, loads, options.tolerance_N, options.newton.iterations_max, bed
            )
            if found.outcome is not Outcome.NOT_FINITE:
                break
        if found.outcome is not Outcome.CONVERGED:
            raise ConvergenceError(
                f"the soft step did not converge: {found.outcome.value}; residual {found.residual_N:.3g} N "
                f"after {found.iterations} iterations; try a shorter tick or a gentler ramp",
                found.residual_N,
                found.iterations,
            )
        if aim is not None and found.residual_N > aim.tolerance_N:
            # below an ordinary step's tolerance rounding may leave no descent
            _, fine = aim.newton(options)
            closer = self._solver.solve(
                found.frames, clamp.free, loads, fine.tolerance_N, fine.iterations_max, bed
            )
            if closer.residual_N <= found.residual_N:
                found = replace(closer, iterations=found.iterations + closer.iterations)
        return SoftState(
            found.frames, (found.frames - base) / span, chain.angles, (x, chain.velocities)
        ), found

    def bed(self, chain: SoftState, step_s: float) -> Bed:
        """Return the inertia of a step that ends at a chain."""
        base, span, _ = difference_scheme(self._options.integrator, chain, step_s)
        coefficient: float = (1.0 + self._options.damping_per_s * span) / span**2
        target: Array = base
        return Bed(coefficient, target)


def _starts(chain: SoftState, flange: Pose, step_s: float) -> Iterator[Array]:
    """Yield frames to start from: in free flight, where they are, and going with the flange.

    Free flight is the best of them, unless it leaves the range of the model.
    """
    x = chain.positions
    yield changed(x, twists(x, chain.velocities), step_s)
    yield x
    yield carried(x, flange @ pose_of_points(x[0]).inverse())
