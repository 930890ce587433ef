"""One implicit step of a film in one kernel: with a factorisation that is kept, from its start to its end.

It takes what most steps are: given pressures and tensions, nothing touched, and iterations with the kept
factorisation that converge at once. Where they do not, nothing has changed, and the step is for
`ImplicitStepper`, which begins as this one did.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray, Mask, PlaceArray
from cosim.base.kernels import (
    BLOCKS,
    BOOLEAN,
    INDICES,
    MASKS,
    MATRIX,
    PLACES,
    REAL,
    VECTOR,
    device_function,
    kernel,
)
from cosim.soft.linear.envelope_kernels import substitute
from cosim.soft.solve.film_arrays import BED, FILM, PLAIN_LOADS, film_gradient
from cosim.soft.solve.held_nodes import HELD, place_held
from cosim.soft.solve.problem import largest_residual
from cosim.soft.solve.step_begin import fill_bed, fill_flight


class StepNumbers(NamedTuple):
    """Numbers of a step; see `StepOptions`, `NewtonOptions` and `step_begin`.

    Args:
        two_steps: whether the step looks back over two.
        h: [s].
        span: s [s].
        factor: s / (1 + alpha s) [s].
        fraction: of the gain in velocity that moves the nodes in free flight.
        tolerance: [N].
        start_tolerance: [N].
        reuse_rate: bound on a residual over the last one.
        step_max: [m].
        reuse_max: iterations at most.
    """

    two_steps: bool
    h: float
    span: float
    factor: float
    fraction: float
    tolerance: float
    start_tolerance: float
    reuse_rate: float
    step_max: float
    reuse_max: int


class KeptEnvelope(NamedTuple):
    """A factorisation by its envelope, see `substitute`, and the flange's axes when it was made.

    Args:
        there: whether there is one.
        store: entries of L.
        start: where each tile's rows begin.
        first: first tile of each.
        inverse: reciprocal diagonal.
        dofs: component of each equation.
        frame: (3, 3), world from flange.
        free: (n, 3), components that move.
    """

    there: bool
    store: Array
    start: PlaceArray
    first: PlaceArray
    inverse: Array
    dofs: IntArray
    frame: Array
    free: Mask


class StepMotion(NamedTuple):
    """Where a step begins, and where it ends: `new_...` and `angles` are filled.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_x: one step earlier; of the first step: x.
        earlier_velocity: the same.
        memory: (h,) [rad], angles of the hinges.
        flange: (4, 3), see `flange_axes`, at the end.
        new_x: (n, 3).
        new_velocity: (n, 3).
        angles: (h,).
    """

    x: Array
    velocity: Array
    earlier_x: Array
    earlier_velocity: Array
    memory: Array
    flange: Array
    new_x: Array
    new_velocity: Array
    angles: Array


class StepWork(NamedTuple):
    """Scratch of a step; `gradient` holds what its end has.

    Args:
        gradient: (n, 3) [N].
        solution: (1, n, 3).
        reference: (h,).
        pull: (segments,).
    """

    gradient: Array
    solution: Array
    reference: Array
    pull: Array


NUMBERS = types.NamedTuple((BOOLEAN, *(8 * [REAL]), types.int64), StepNumbers)
KEPT = types.NamedTuple((BOOLEAN, VECTOR, PLACES, PLACES, VECTOR, INDICES, MATRIX, MASKS), KeptEnvelope)
MOTION = types.NamedTuple((*(4 * [MATRIX]), VECTOR, *(3 * [MATRIX]), VECTOR), StepMotion)
WORK = types.NamedTuple((MATRIX, BLOCKS, VECTOR, VECTOR), StepWork)


@device_function
def _turn_since(kept, flange, turn):  # type: ignore[no-untyped-def]
    """Fill turn (3, 3) with the rotation from the kept factorisation's axes to the flange's."""
    for r in range(3):
        for c in range(3):
            turn[r, c] = 0.0
            for k in range(3):
                turn[r, c] += flange[1 + k, r] * kept.frame[c, k]


@device_function
def _solve(kept, turn, work):  # type: ignore[no-untyped-def]
    """Fill the solution under minus the gradient; return its largest component, NaN if one is none."""
    solution, longest = work.solution[0], 0.0
    for i in range(solution.shape[0]):
        for r in range(3):
            solution[i, r] = -work.gradient[i, r]
    substitute(kept.store, kept.start, kept.first, kept.inverse, kept.dofs, turn, work.solution)
    for i in range(solution.shape[0]):
        for r in range(3):
            if math.isnan(solution[i, r]):
                return math.nan
            longest = max(longest, abs(solution[i, r]))
    return longest


@device_function
def _iterate(film, loads, bed, kept, numbers, motion, work):  # type: ignore[no-untyped-def]
    """Iterate from `new_x` with the kept factorisation; return what `film_step` does."""
    turn, reference, x, angles = np.empty((3, 3)), work.reference, motion.new_x, motion.angles
    _turn_since(kept, motion.flange, turn)
    reference[:] = motion.memory
    angles[:] = motion.memory
    energy = film_gradient(film, loads, bed, x, reference, work.pull, angles, work.gradient)
    residual, iterations = largest_residual(x, work.gradient, kept.free), 0
    bound = numbers.start_tolerance
    while math.isfinite(energy) and math.isfinite(residual):
        if residual < bound:
            return True, iterations, residual, energy
        if not kept.there or iterations == numbers.reuse_max:
            return False, iterations, residual, energy
        if not _solve(kept, turn, work) <= numbers.step_max:
            return False, iterations, residual, energy
        for i in range(x.shape[0]):
            for r in range(3):
                x[i, r] += work.solution[0, i, r]
        reference[:] = angles
        energy = film_gradient(film, loads, bed, x, reference, work.pull, angles, work.gradient)
        before, residual = residual, largest_residual(x, work.gradient, kept.free)
        if not residual <= numbers.reuse_rate * before:
            return False, iterations, residual, energy
        iterations, bound = iterations + 1, numbers.tolerance
    return False, iterations, residual, energy


@kernel(
    types.Tuple((BOOLEAN, types.int64, REAL, REAL))(FILM, PLAIN_LOADS, BED, KEPT, HELD, NUMBERS, MOTION, WORK)
)
def film_step(film, loads, bed, kept, held, numbers, motion, work):  # type: ignore[no-untyped-def]
    """Take a step; return (whether it has converged, iterations, residual [N], potential [J]).

    Fills the bed's target and the end of the motion; `bed`, `motion` and `work` say what they hold.
    """
    x, velocity, new_x, new_velocity = motion.x, motion.velocity, motion.new_x, motion.new_velocity
    base, before = new_velocity, motion.earlier_velocity
    fill_bed(x, velocity, motion.earlier_x, before, numbers.two_steps, numbers.factor, base, bed.target)
    fill_flight(x, velocity, before, numbers.h, numbers.fraction, new_x)
    place_held(held, motion.flange, new_x)
    converged, iterations, residual, energy = _iterate(film, loads, bed, kept, numbers, motion, work)
    for i in range(x.shape[0]):
        for r in range(3):
            new_velocity[i, r] = (new_x[i, r] - base[i, r]) / numbers.span
    return converged, iterations, residual, energy
