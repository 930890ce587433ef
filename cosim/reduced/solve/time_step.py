"""Implicit steps of a chain of frames: the schemes of `cosim.soft.solve.time_step` on the frames' points.

What the next step of a chain of frames depends on.

A chain of frames and what acts on it, as one argument of a kernel that takes many steps.

The factor of a step's tangent, kept for the steps to come while it serves them.

One implicit step of a chain of frames, from its start to the wrench at the flange, as a kernel.

The schemes are those of `cosim.soft.solve.time_step`: with v = (x - base) / span,
acceleration = (v - speed) / span and damping alpha, inertia is an elastic bed of coefficient
(1 + alpha span) / span^2 about the target base + span / (1 + alpha span) speed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.base.kernels import (
    Blocks,
    Cubes,
    Flags,
    Indices,
    Matrix,
    Vector,
    address_of,
    device_function,
    kernel,
    small_vector,
)
from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.sections.assembly import (
    FIGURES,
    change_frames,
    copy_frames,
    fill_figures,
    minimise,
)
from cosim.reduced.solve.clamp import FrameClamp, check_pressure, place_in_range
from cosim.reduced.solve.commanded_cables import CLOSE_N, commanded, solve_commanded, tensions_at
from cosim.reduced.solve.newton import OUTCOMES, Bed, ChainSolver, solve_sealed
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.state import StepAim, StepOptions, inertia_weight


@final
@dataclass(frozen=True)
class ChainState:
    """Points of all frames and their velocities.

    Args:
        motion: (2, f, 4, 3), positions [m] of the origins and unit axes, and the velocities of both.
        earlier: (2, f, 4, 3), the same one step before, for two-step integrators; None for none.
    """

    motion: Annotated[Array, (2, "frames", 4, 3)]
    earlier: Annotated[Array, (2, "frames", 4, 3)] | None = None

    @classmethod
    def at_rest(cls, frames: Array) -> ChainState:
        """Return frames (f, 4, 3) without velocity."""
        return cls(np.array((frames, np.zeros_like(frames))))

    @property
    def frames(self) -> Array:
        """(f, 4, 3) origins [m] and axes."""
        frames: Array = self.motion[0]
        return frames

    @property
    def rates(self) -> Array:
        """(f, 4, 3), velocities of the origins [m/s] and axes [1/s]."""
        rates: Array = self.motion[1]
        return rates


class ChainArrays(NamedTuple):
    """What the chain is; see `implicit_step`, and `SectionBody` for the tables over pressure.

    Args:
        call: address of the kernel of a step.
        free: (f,).
        offsets: (f, 4, 3).
        coefficients: (s, c).
        inverse_length: (s,).
        mass: (f, 4, 4).
        load: (f, 4, 3).
        far: (k,).
        eyelets: (k, 2, 3).
        touching: (0,), as nothing is touched.
        rows: (0, 17).
        widths: (2,).
        energies: (size, s c).
        lengths: (size, s).
        eyelet_table: (size, 6 k).
        target: (f, 4, 3), scratch.
        diagonal: (f, 6, 6), scratch.
        off: (f, 6, 6), scratch.
        low: (f, 6, 6), kept factor.
        side: (f, 6, 6), the same.
        bounds: (2,), see `minimise`.
    """

    call: int
    free: Flags
    offsets: Blocks
    coefficients: Matrix
    inverse_length: Vector
    mass: Blocks
    load: Blocks
    far: Indices
    eyelets: Blocks
    touching: Indices
    rows: Matrix
    widths: Vector
    energies: Matrix
    lengths: Matrix
    eyelet_table: Matrix
    target: Blocks
    diagonal: Blocks
    off: Blocks
    low: Blocks
    side: Blocks
    bounds: Vector


@final
@dataclass(frozen=True)
class KeptTangentState:
    """A kept factor.

    Args:
        low: (f, 6, 6), of the Cholesky factor.
        side: (f, 6, 6).
        step_s: length of the step that it was made in [s].
        two_steps: whether that looked back over two steps.
    """

    low: Annotated[Array, ("frames", 6, 6)]
    side: Annotated[Array, ("frames", 6, 6)]
    step_s: float
    two_steps: bool


@final
class KeptTangent:
    """Owns the factor; it serves steps of one length and scheme in one clamp.

    Args:
        count: of the frames.
    """

    def __init__(self, count: int) -> None:
        self.low, self.side = np.zeros((count, 6, 6)), np.zeros((count, 6, 6))
        self._clamp: FrameClamp | None = None
        self._step_s, self._two_steps = 0.0, False

    def serves(self, clamp: FrameClamp, step_s: float, two_steps: bool) -> bool:
        """Whether there is a factor that such a step may begin with."""
        return clamp is self._clamp and step_s == self._step_s and two_steps == self._two_steps

    def keep(self, kept: bool, clamp: FrameClamp, step_s: float, two_steps: bool) -> None:
        """Note the step in which the factor was made or used last, and whether it is worth keeping."""
        self._clamp, self._step_s, self._two_steps = clamp if kept else None, step_s, two_steps

    def save_state(self, clamp: FrameClamp) -> KeptTangentState | None:
        """Return the factor; None where none is kept for a clamp."""
        if clamp is not self._clamp:
            return None
        return KeptTangentState(self.low.copy(), self.side.copy(), self._step_s, self._two_steps)

    def restore_state(self, state: KeptTangentState | None, clamp: FrameClamp) -> None:
        """Return to a state of `save_state`, with the clamp of that moment."""
        if state is None:
            self._clamp = None
            return
        self.low[:], self.side[:] = state.low, state.side
        self.keep(True, clamp, state.step_s, state.two_steps)


FREE_FLIGHT, STANDING, CARRIED, GIVEN = 0, 1, 2, 3
"""Where Newton's method starts: as if nothing acted, where the frames are, as if rigid on the flange, or from
what is in the result already."""


@device_function
def _scheme(
    here: Cubes, earlier: Cubes, two_steps: bool, h: float, damping: float, base: Blocks, target: Blocks
) -> tuple[float, float]:
    """Fill base and target (f, 4, 3); return span and the bed's coefficient."""
    span = 2.0 * h / 3.0 if two_steps else h
    share = span / (1.0 + damping * span)
    for f in range(base.shape[0]):
        for a in range(4):
            for r in range(3):
                x, speed = here[0, f, a, r], here[1, f, a, r]
                if two_steps:
                    x = (4.0 * x - earlier[0, f, a, r]) / 3.0
                    speed = (4.0 * speed - earlier[1, f, a, r]) / 3.0
                base[f, a, r] = x
                target[f, a, r] = x + share * speed
    return span, (1.0 + damping * span) / (span * span)


@device_function
def _free_flight(here: Cubes, h: float, twists: Matrix, out: Blocks) -> None:
    """Fill out (f, 4, 3) with the frames after moving on as they do; twists (f, 6) is scratch."""
    for f in range(out.shape[0]):
        for r in range(3):
            i, k = (r + 1) % 3, (r + 2) % 3
            twists[f, r] = here[1, f, 0, r]
            spin = 0.0
            for a in range(1, 4):
                spin += here[0, f, a, i] * here[1, f, a, k] - here[0, f, a, k] * here[1, f, a, i]
            twists[f, 3 + r] = 0.5 * spin
    change_frames(here[0], twists, h, out)


@device_function
def _carry(frames: Blocks, flange: Matrix, out: Blocks) -> None:
    """Fill out (f, 4, 3) with the frames moved rigidly as frame 0 comes to the flange (4, 3)."""
    arm = small_vector(3)
    for f in range(out.shape[0]):
        for a in range(4):
            for i in range(3):
                arm[i] = 0.0
                for r in range(3):
                    from_origin = frames[f, a, r] - (frames[0, 0, r] if a == 0 else 0.0)
                    arm[i] += from_origin * frames[0, i + 1, r]
            for r in range(3):
                out[f, a, r] = arm[0] * flange[1, r] + arm[1] * flange[2, r] + arm[2] * flange[3, r]
                if a == 0:
                    out[f, a, r] += flange[0, r]


@device_function
def _place(free: Flags, offsets: Blocks, flange: Matrix, out: Blocks) -> None:
    """Put the held frames of out where the flange (4, 3) has them, offsets (f, 4, 3) in its frame."""
    for f in range(out.shape[0]):
        if free[f]:
            continue
        for a in range(4):
            for r in range(3):
                out[f, a, r] = (
                    offsets[f, a, 0] * flange[1, r] + offsets[f, a, 1] * flange[2, r]
                    + offsets[f, a, 2] * flange[3, r] + (flange[0, r] if a == 0 else 0.0)
                )  # fmt: skip


@kernel
def implicit_step(
    here: Cubes,
    earlier: Cubes,
    two_steps: bool,
    h: float,
    damping: float,
    start: int,
    flange: Matrix,
    free: Flags,
    offsets: Blocks,
    coefficients: Matrix,
    inverse_length: Vector,
    mass: Blocks,
    load: Blocks,
    far: Indices,
    eyelets: Blocks,
    tension: Vector,
    touching: Indices,
    rows: Matrix,
    widths: Vector,
    target: Blocks,
    diagonal: Blocks,
    off: Blocks,
    low: Blocks,
    side: Blocks,
    kept: bool,
    bounds: Vector,
    iterations_max: int,
    there: Cubes,
    gradient: Matrix,
    figures: Vector,
) -> tuple[int, int, float, bool]:
    """Take one step of h [s] from `here` (2, f, 4, 3); return (outcome, iterations, residual [N], kept).

    Fills `there` with the motion at its end, the gradient (f, 6) of the potential and the chain's figures.
    target (f, 4, 3), diagonal and off (f, 6, 6) are scratch; for low, side and kept see `minimise`.
    """
    frames, base = there[0], there[1]
    span, bed = _scheme(here, earlier, two_steps, h, damping, base, target)
    if start == FREE_FLIGHT:
        _free_flight(here, h, gradient, frames)
    elif start == STANDING:
        copy_frames(here[0], frames)
    elif start == CARRIED:
        _carry(here[0], flange, frames)
    _place(free, offsets, flange, frames)
    outcome, iterations, residual, _, _, kept = minimise(
        frames, free, coefficients, inverse_length, mass, load, bed, target, far, eyelets, tension,
        touching, rows, widths, gradient, diagonal, off, low, side, kept, bounds, iterations_max,
    )  # fmt: skip
    for f in range(base.shape[0]):
        for a in range(4):
            for r in range(3):
                base[f, a, r] = (frames[f, a, r] - base[f, a, r]) / span
    fill_figures(frames, free, mass, gradient, figures)
    return outcome, iterations, residual, kept


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
        earlier = motion if chain.earlier is None or not two_steps else chain.earlier
        tangent = self.tangent
        outcome, iterations, residual, kept = implicit_step(
            motion, earlier, two_steps, step_s, self._options.damping_per_s,
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
