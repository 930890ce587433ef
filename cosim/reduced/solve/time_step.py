"""Implicit steps of a chain of frames: the schemes of `cosim.soft.solve.time_step` on the frames' points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.base.kernels import address_of
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.sections.outputs import FIGURES
from cosim.reduced.solve.arrays import ChainArrays
from cosim.reduced.solve.clamp import FrameClamp
from cosim.reduced.solve.commanded_cables import CLOSE_N, commanded, solve_commanded, tensions_at
from cosim.reduced.solve.implicit_step import CARRIED, FREE_FLIGHT, GIVEN, STANDING, implicit_step
from cosim.reduced.solve.kept_tangent import KeptTangent
from cosim.reduced.solve.newton import OUTCOMES, Bed, ChainSolver
from cosim.reduced.solve.sealed_pressure import solve_sealed
from cosim.reduced.solve.state import ChainState
from cosim.reduced.solve.working_range import check_pressure, place_in_range
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.time_scheme import StepAim, StepOptions, inertia_weight


@final
@dataclass(frozen=True)
class ChainStep:
    """Where a step ended.

    Args:
        chain: there.
        gradient: (f, 6) [N, N m] of the potential by (dr, phi) of each frame, inertia included.
        figures: of the chain, see `chain_figures`.
        outcome: how Newton's method ended.
        iterations: linear solves.
        residual_N: largest out-of-balance force of a free frame, or moment over its lever.
        pressure_Pa: gauge pressure of the gas.
    """

    chain: ChainState
    gradient: Array
    figures: Array
    outcome: Outcome
    iterations: int
    residual_N: float
    pressure_Pa: float

    @property
    def frames(self) -> Array:
        """(f, 4, 3)."""
        return self.chain.frames


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
        self._bounds = np.array((options.tolerance_N, solver.lever_m))
        self._flange = np.zeros((4, 3))
        self.tangent = KeptTangent(len(solver.section.frames))
        self._target = np.zeros((len(solver.section.frames), 4, 3))

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

    def arrays(self, clamp: FrameClamp, loads: Loads, frames: Array) -> ChainArrays:
        """Return chain, loads and workspace for steps that are taken elsewhere; see `ChainArrays`.

        Args:
            clamp: frames held by the flange.
            loads: that act in the first of them: given pressure and tensions, dead loads.
            frames: (f, 4, 3), where they begin.
        """
        solver, tangent = self._solver, self.tangent
        load, (far, eyelets, _, touching, rows, widths) = solver.acting(loads, loads.pressures(1)[0], frames)
        return ChainArrays(
            address_of(implicit_step), clamp.free, clamp.offsets, *solver.section.chain, load, far, eyelets,
            touching, rows, widths, *solver.section.tables, solver.eyelet_table, self._target,
            solver.diagonal, solver.off, tangent.low, tangent.side, self._bounds,
        )  # fmt: skip

    def step(
        self,
        chain: ChainState,
        clamp: FrameClamp,
        flange: Pose,
        loads: Loads,
        step_s: float,
        begin_Pa: float = 0.0,
        aim: StepAim | None = None,
    ) -> ChainStep:
        """Advance by one step, with the flange at its new pose.

        Args:
            chain: at the beginning.
            clamp: frames held by the flange.
            flange: its pose at the end.
            loads: at the end.
            step_s: h [s].
            begin_Pa: gauge pressure at the beginning, with sealed gas.
            aim: how closely; `start` is of frames (f, 4, 3). As an ordinary step unless given.

        Raises:
            ConvergenceError: no solution; the caller still holds `chain`.
        """
        self._flange[0], self._flange[1:] = flange.translation, flange.rotation.T
        options, drive = self._options, (chain, clamp, loads, step_s)
        bounds = (self._bounds, options.newton.iterations_max)
        # free flight is the best start, unless it leaves the range of the model
        starts: list[int | Array] = [FREE_FLIGHT, STANDING, CARRIED]
        if aim is not None and aim.start is not None:
            starts.insert(0, aim.start)
        for start in starts:
            found = self._solve(*drive, start, begin_Pa, bounds)
            if found.outcome is not Outcome.NOT_FINITE:
                break
        if found.outcome is not Outcome.CONVERGED:
            raise self._failure(found, chain)
        check_pressure(self._solver.section, found.pressure_Pa, found.residual_N, found.iterations)
        if aim is not None and found.residual_N > aim.tolerance_N:
            # below an ordinary step's tolerance rounding may leave no descent
            _, fine = aim.newton(options)
            bounds = (np.array((fine.tolerance_N, self._solver.lever_m)), fine.iterations_max)
            closer = self._solve(*drive, found.frames, found.pressure_Pa, bounds)
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

    def _solve(
        self,
        chain: ChainState,
        clamp: FrameClamp,
        loads: Loads,
        step_s: float,
        start: int | Array,
        begin_Pa: float,
        bounds: tuple[Array, int],
    ) -> ChainStep:
        """Take the step from a start: one of the kernel's, or frames (f, 4, 3)."""
        if not commanded(loads):
            return self._solve_pulled(chain, clamp, loads, step_s, start, begin_Pa, bounds)
        closely = (np.array((min(CLOSE_N, bounds[0][0]), bounds[0][1])), bounds[1])

        def attempt(pulled: Loads, before: ChainStep | None) -> ChainStep:
            begin, pressure = (start, begin_Pa) if before is None else (before.frames, before.pressure_Pa)
            return self._solve_pulled(chain, clamp, pulled, step_s, begin, pressure, closely)

        pressure = begin_Pa if loads.gases(1)[0] is not None else loads.pressures(1)[0]
        before = tensions_at(self._solver, chain.frames, loads, pressure)
        bed = self.bed(chain, step_s)
        return solve_commanded(self._solver, clamp.free, loads, before, attempt, bed)

    def _solve_pulled(
        self,
        chain: ChainState,
        clamp: FrameClamp,
        loads: Loads,
        step_s: float,
        start: int | Array,
        begin_Pa: float,
        bounds: tuple[Array, int],
    ) -> ChainStep:
        """Take the step under given tensions."""
        gas = loads.gases(1)[0]
        if gas is None:
            pressure = loads.pressures(1)[0]
            return self._attempt(chain, clamp, loads, step_s, pressure, start, bounds)

        def attempt(pressure_Pa: float, before: ChainStep | None) -> ChainStep:
            begin = start if before is None else before.frames
            return self._attempt(chain, clamp, loads, step_s, pressure_Pa, begin, bounds)

        return solve_sealed(gas, begin_Pa, self._solver.section.volume, attempt)

    def _attempt(
        self,
        chain: ChainState,
        clamp: FrameClamp,
        loads: Loads,
        step_s: float,
        pressure_Pa: float,
        start: int | Array,
        bounds: tuple[Array, int],
    ) -> ChainStep:
        """Take the step at a pressure."""
        solver, motion = self._solver, chain.motion
        there = np.empty_like(motion)
        gradient, figures = np.empty((len(self._target), 6)), np.empty(FIGURES)
        near = motion[0]
        if not isinstance(start, int):
            there[0] = near = start
            start = GIVEN
        elif solver.losses_follow_shape:
            near = near + step_s * motion[1]
        load, others = solver.acting(loads, pressure_Pa, near)
        two_steps = self._two_steps and chain.earlier is not None
        tangent = self.tangent
        outcome, iterations, residual, kept = implicit_step(
            motion, chain.earlier if two_steps else motion, two_steps, step_s, self._options.damping_per_s,
            start, self._flange, clamp.free, clamp.offsets, *solver.section.chain, load, *others,
            self._target, solver.diagonal, solver.off, tangent.low, tangent.side,
            tangent.serves(clamp, step_s, two_steps), *bounds, there, gradient, figures,
        )  # fmt: skip
        tangent.keep(kept, clamp, step_s, two_steps)
        after = ChainState(there, motion)
        return ChainStep(after, gradient, figures, OUTCOMES[outcome], iterations, residual, pressure_Pa)

    def bed(self, chain: ChainState, step_s: float) -> Bed:
        """Return the inertia of a step that ends at a chain."""
        two_steps = self._two_steps and chain.earlier is not None
        span = 2.0 * step_s / 3.0 if two_steps else step_s
        base = chain.frames
        if two_steps and chain.earlier is not None:
            base = (4.0 * base - chain.earlier[0]) / 3.0
        return Bed(inertia_weight(span, self._options.damping_per_s), base)
