"""Kernel of an implicit step of a chain of frames, or of its equilibrium, by Newton's method.

The tangent is small. Inertia and damping of a step are a quadratic term on the frames' points, see
`cosim.soft.solve.step_prediction`; statics have none. The factor of an earlier tangent may be reused.
"""

from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Blocks, Cubes, Flags, Matrix, Vector
from cosim.base.kernels import copy, device_function, kernel, small_matrix, small_vector
from cosim.reduced.sections import assembly, chain_shape, figures
from cosim.reduced.sections.chain_arrays import ChainWork, InertiaTerm, LoadedChain
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.step_prediction import StepCoefficients, fill_inertia_target

CONVERGED, LIMIT, NOT_FINITE, INDEFINITE, NO_DESCENT, GOES_ON = range(6)
OUTCOMES: Final = (
    Outcome.CONVERGED, Outcome.ITERATION_LIMIT, Outcome.NOT_FINITE, Outcome.INDEFINITE, Outcome.NO_DESCENT,
)  # fmt: skip
"""In the order of the numbers that the kernel returns."""
FREE_FLIGHT, STANDING, CARRIED, GIVEN = 0, 1, 2, 3
"""Start of Newton's method: free flight without forces, present frames, rigid motion with the flange, or the
contents of the result array."""
_SHIFT_START, _SHIFT_MAX = 0.05, 1e8  # [N/m]
_STEP_MAX_M, _TURN_MAX = 0.05, 0.4
_HALVINGS_MAX = 20


@final
@dataclass(frozen=True)
class ChainState:
    """Points of all frames and their velocities, and the gas between them.

    Args:
        motion: (2, f, 4, 3), positions [m] of the origins and unit axes, and the velocities of both.
        pressure_Pa: gauge pressure of the gas.
        earlier: (2, f, 4, 3), the same one step before, for two-step integrators; None for none.
    """

    motion: Annotated[Array, (2, "frames", 4, 3)]
    pressure_Pa: float
    earlier: Annotated[Array, (2, "frames", 4, 3)] | None = None

    @classmethod
    def at_rest(cls, frames: Array, pressure_Pa: float) -> "ChainState":
        """Return frames (f, 4, 3) without velocity."""
        return cls(np.array((frames, np.zeros_like(frames))), pressure_Pa)

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


@final
@dataclass(frozen=True)
class ChainStep:
    """Result of a step, or an equilibrium.

    Args:
        chain: final state.
        gradient: (f, 6) [N, N m] of the potential by (dr, phi) of each frame, inertia included.
        figures: of the chain, see `fill_figures`.
        outcome: how Newton's method ended.
        iterations: linear solves.
        residual_N: largest out-of-balance force of a free frame, or moment over its lever.
        potential_J: potential of the final state.
        shifted: number of solves with an indefinite tangent.
    """

    chain: ChainState
    gradient: Array
    figures: Array
    outcome: Outcome
    iterations: int
    residual_N: float
    potential_J: float = float("nan")
    shifted: int = 0

    @property
    def frames(self) -> Array:
        """(f, 4, 3)."""
        return self.chain.frames

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure of the gas."""
        return self.chain.pressure_Pa


class ChainSide(NamedTuple):
    """A chain, how it is held, and its workspace.

    Args:
        chain: with its loads.
        free: (f,) frames that can move.
        offsets: (f, 4, 3), of held frames in the flange's; in statics without meaning.
        work: scratch, and a factor that may be reused.
    """

    chain: LoadedChain
    free: Flags
    offsets: Blocks
    work: ChainWork


class ChainScheme(NamedTuple):
    """Scheme and bounds of a solution.

    Args:
        h: length of a step [s].
        coefficients: of the step.
        inertia: stiffness of the inertia term over the mass [1/s^2]; 0 for an equilibrium.
        tolerance_N: residual at which it is done.
        lever_m: by which moments are divided.
        iterations_max: linear solves.
    """

    h: float
    coefficients: StepCoefficients
    inertia: float
    tolerance_N: float
    lever_m: float
    iterations_max: int

    @classmethod
    def of_statics(cls, tolerance_N: float, lever_m: float, iterations_max: int) -> "ChainScheme":
        """Return that of equilibria."""
        return cls(0.0, StepCoefficients(False, 1.0, 0.0, 0.0), 0.0, tolerance_N, lever_m, iterations_max)


class ChainEnds(NamedTuple):
    """Where a solution begins and ends.

    Args:
        begin: (2, f, 4, 3), points and their velocities at the start of a step.
        earlier: (2, f, 4, 3), the same one step earlier.
        flange: (4, 3), its origin and axes at the end.
        end: (2, f, 4, 3), points and their velocities at the end; filled.
        gradient: (f, 6) [N, N m], of the potential at the end, inertia included; filled.
        figures: (FIGURES,), filled, see `fill_figures`.
    """

    begin: Cubes
    earlier: Cubes
    flange: Matrix
    end: Cubes
    gradient: Matrix
    figures: Vector


@device_function
def _residual(gradient: Matrix, free: Flags, lever: float) -> float:
    """Return the largest out-of-balance force, or moment over lever."""
    largest = 0.0
    for f in range(free.shape[0]):
        if free[f]:
            for i in range(6):
                value = abs(gradient[f, i]) / (1.0 if i < 3 else lever)
                if not value <= largest:
                    largest = value
    return largest


@device_function
def _fill_step(side: ChainSide, gradient: Matrix, lever: float, renewed: bool) -> tuple[float, float, float]:
    """Fill the step of a tangent; with `renewed` its factor is computed first.

    Returns the least shift [N/m] tried that makes it definite, or one too large; the potential's slope along
    the step, and the factor that bounds it.
    """
    free, step, shift, scale = side.free, side.work.step, 0.0, small_vector(6)
    for i in range(6):
        scale[i] = 1.0 if i < 3 else lever * lever
    while renewed and shift <= _SHIFT_MAX and not assembly.factorise(free, side.work, shift, scale):
        shift = max(_SHIFT_START, 6.0 * shift)
    assembly.substitute(free, side.work, gradient)
    slope = longest = turn = 0.0
    for f in range(free.shape[0]):
        for i in range(6):
            step[f, i] = -step[f, i]
            slope += gradient[f, i] * step[f, i] if free[f] else 0.0
            if i < 3:
                longest = max(longest, abs(step[f, i]))
            else:
                turn = max(turn, abs(step[f, i]))
    factor = min(1.0, min(_STEP_MAX_M / max(longest, 1e-30), _TURN_MAX / max(turn, 1e-30)))
    return shift, slope, factor


@device_function
def _minimise(
    side: ChainSide, scheme: ChainScheme, coefficients: InertiaTerm, ends: ChainEnds, reused: bool
) -> tuple[int, int, float, bool, float, int]:
    """Find the minimum of the potential near the frames at the end, which are moved there.

    The factor of an earlier tangent is used, where there is one, while the residual falls fast enough.
    """
    frames, gradient, work, tolerance = ends.end[0], ends.gradient, side.work, scheme.tolerance_N
    copy(frames.reshape(-1), work.trial.reshape(-1))
    iterations = shifted = tries = uses = 0
    energy = residual = slope = factor = 0.0
    # numba would compile everything again for a literal
    renew, judged, factor_is_old, definite, outcome = not reused, iterations > 0, reused, reused, GOES_ON
    while outcome == GOES_ON:
        trial_energy = assembly.assemble(work.trial, side.chain, coefficients, gradient, work, renew)
        before, residual = residual, _residual(gradient, side.free, scheme.lever_m)
        # a step is accepted that has lowered the potential as it should, or the residual by far
        largest_energy = energy + 1e-4 * (factor * slope) + 1e-13 * (1.0 + abs(energy))
        accepted = np.isfinite(trial_energy) and (trial_energy <= largest_energy or residual < 0.1 * before)
        if judged and not accepted:
            residual, tries, factor = before, tries + 1, 0.5 * factor
            if factor_is_old:  # a new tangent, where the step began
                copy(frames.reshape(-1), work.trial.reshape(-1))
                renew, judged, factor_is_old = True, False, False
            elif tries < _HALVINGS_MAX:
                chain_shape.change_frames(frames, work.step, factor, work.trial)
            else:
                outcome = NO_DESCENT
            continue
        energy = trial_energy
        copy(work.trial.reshape(-1), frames.reshape(-1))
        if not (np.isfinite(residual) and np.isfinite(energy)):
            outcome = NOT_FINITE
        elif residual <= tolerance:
            outcome = CONVERGED
        elif iterations >= scheme.iterations_max:
            outcome = LIMIT
        if outcome != GOES_ON:
            break
        if judged and not (factor_is_old and residual * residual <= tolerance * before):
            renew, judged, factor_is_old = True, False, False
            continue
        iterations += 1
        shift, slope, factor = _fill_step(side, gradient, scheme.lever_m, renew)
        outcome = INDEFINITE if shift > _SHIFT_MAX else GOES_ON
        definite, uses = shift == 0.0 if renew else definite, 0 if renew else uses + 1
        shifted += shift > 0.0
        renew, judged, tries = False, True, 0
        chain_shape.change_frames(frames, work.step, factor, work.trial)
    return outcome, iterations, residual, outcome == CONVERGED and definite and uses < 2, energy, shifted


@device_function
def _start(side: ChainSide, ends: ChainEnds, h: float, start: int) -> None:
    """Fill the frames at the end where Newton's method starts, the held ones where the flange has them."""
    begin_points, flange, end_frames, twists = ends.begin, ends.flange, ends.end[0], ends.gradient
    free = side.free
    frames, arm, offsets = begin_points[0], small_vector(3), side.offsets
    if start == FREE_FLIGHT:
        for f in range(end_frames.shape[0]):
            for r in range(3):
                i, k = (r + 1) % 3, (r + 2) % 3
                twists[f, r] = begin_points[1, f, 0, r]
                spin = 0.0
                for a in range(1, 4):
                    spin += (
                        begin_points[0, f, a, i] * begin_points[1, f, a, k]
                        - begin_points[0, f, a, k] * begin_points[1, f, a, i]
                    )
                twists[f, 3 + r] = 0.5 * spin
        chain_shape.change_frames(frames, twists, h, end_frames)
    elif start == STANDING:
        copy(frames.reshape(-1), end_frames.reshape(-1))
    for f in range(end_frames.shape[0]):
        if free[f] and start != CARRIED:
            continue
        for a in range(4):
            for i in range(3):
                arm[i] = 0.0 if free[f] else offsets[f, a, i]
                for r in range(3 if free[f] else 0):
                    from_origin = frames[f, a, r] - (frames[0, 0, r] if a == 0 else 0.0)
                    arm[i] += from_origin * frames[0, i + 1, r]
            for r in range(3):
                end_frames[f, a, r] = arm[0] * flange[1, r] + arm[1] * flange[2, r] + arm[2] * flange[3, r]
                if a == 0:
                    end_frames[f, a, r] += flange[0, r]


@device_function
def _fill_carried(before: Blocks, after: Blocks, held_frame: int, displacements: Blocks) -> None:
    """Fill displacements (f, 4, 3) of the points in a rigid motion with a held frame."""
    turn = small_matrix(3, 3)
    for r in range(3):
        for c in range(3):
            turn[r, c] = 0.0
            for a in range(1, 4):
                turn[r, c] += after[held_frame, a, r] * before[held_frame, a, c]
    for f in range(before.shape[0]):
        for a in range(4):
            for r in range(3):
                displacements[f, a, r] = -before[f, a, r] + (after[held_frame, 0, r] if a == 0 else 0.0)
                for c in range(3):
                    displacements[f, a, r] += turn[r, c] * (
                        before[f, a, c] - (before[held_frame, 0, c] if a == 0 else 0.0)
                    )


@device_function
def _follow_flange(side: ChainSide, ends: ChainEnds, coefficients: StepCoefficients) -> None:
    """Fill `along` in the workspace with the velocity of points that move rigidly with the flange.

    It is (X - a) / s with X and a made in the same way from carried points and from points.
    """
    along, room, earlier_room = side.work.along, side.work.trial, side.work.target
    held_frame = 0
    while held_frame < side.free.shape[0] and side.free[held_frame]:
        held_frame += 1
    if held_frame == side.free.shape[0]:
        return
    _fill_carried(ends.begin[0], ends.end[0], held_frame, room)
    if coefficients.two_steps:
        _fill_carried(ends.earlier[0], ends.end[0], held_frame, earlier_room)
    points = 4 * along.shape[0], 3
    carried, earlier = room.reshape(points), earlier_room.reshape(points)
    fill_inertia_target(
        carried, carried, earlier, earlier, carried, coefficients, along.reshape(points), carried
    )
    for f in range(along.shape[0]):
        for a in range(4):
            for r in range(3):
                along[f, a, r] /= coefficients.span


@device_function
def _add_damping(side: ChainSide, ends: ChainEnds, damping: float) -> None:
    """Add the reaction of the flange to damping, M alpha (v - u), to the wrench in the figures."""
    frames, velocity, mass, along = ends.end[0], ends.end[1], side.chain.mass, side.work.along
    force, out = small_vector(3), ends.figures
    for f in range(frames.shape[0]):
        for a in range(4):
            for r in range(3):
                force[r] = 0.0
                for b in range(4):
                    force[r] += damping * mass[f, a, b] * (velocity[f, b, r] - along[f, b, r])
            for r in range(3):
                i, k = (r + 1) % 3, (r + 2) % 3
                arm_i, arm_k = frames[f, a, i], frames[f, a, k]
                if a == 0:
                    arm_i, arm_k = arm_i - frames[0, 0, i], arm_k - frames[0, 0, k]
                    out[figures.WRENCH + r] += force[r]
                out[figures.WRENCH + 3 + r] += arm_i * force[k] - arm_k * force[i]


@kernel
def solve_chain(
    side: ChainSide, scheme: ChainScheme, ends: ChainEnds, start: int, reused: bool
) -> tuple[int, int, float, bool, float, int]:
    """Find an equilibrium near the frames in `ends`, or solve one step in time.

    Args:
        side: chain, loads and clamp.
        scheme: numbers of the time step and of Newton's method.
        ends: arrays of the initial and the final state.
        start: of Newton's method, such as FREE_FLIGHT.
        reused: whether to begin with the factor of an earlier tangent.

    Returns:
        Outcome, iterations, residual [N], whether the factor that is left may be reused by the next solution,
        potential [J], number of iterations with an indefinite tangent.
    """
    begin_points, earlier, frames, base = ends.begin, ends.earlier, ends.end[0], ends.end[1]
    coefficients, work, steps = scheme.coefficients, side.work, scheme.inertia > 0.0
    if steps:
        _start(side, ends, scheme.h, start)
        if coefficients.alpha_s > 0.0:
            _follow_flange(side, ends, coefficients)
        points = 4 * base.shape[0], 3
        fill_inertia_target(
            begin_points[0].reshape(points), begin_points[1].reshape(points), earlier[0].reshape(points),
            earlier[1].reshape(points), work.along.reshape(points), coefficients, base.reshape(points),
            work.target.reshape(points),
        )  # fmt: skip
    result = _minimise(side, scheme, InertiaTerm(scheme.inertia, work.target), ends, reused)
    for f in range(base.shape[0]):
        for a in range(4):
            for r in range(3):
                base[f, a, r] = (frames[f, a, r] - base[f, a, r]) / coefficients.span if steps else 0.0
    figures.fill_figures(frames, side.free, side.chain.mass, ends.gradient, ends.figures)
    if steps and coefficients.alpha_s > 0.0:
        _add_damping(side, ends, coefficients.alpha_s / coefficients.span)
    return result
