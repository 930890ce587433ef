"""One implicit step of a film in one kernel: its start, and iterations with a factorisation that is kept.

It knows given pressures and tensions, and what the film may touch in the scene. Where an iteration does not
serve, the step is left at the point before it: there a new tangent is asked for, from which a further call
goes on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray, Mask, PlaceArray
from cosim.base.kernel_calls import address_of, caller
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
from cosim.soft.contact.obstacle_contact import TOUCHED
from cosim.soft.linear.envelope_kernels import substitute
from cosim.soft.solve.film_arrays import BED, FILM, PLAIN_LOADS, FilmArrays, StepBed, film_gradient
from cosim.soft.solve.held_nodes import HELD, HeldNodes, place_flight
from cosim.soft.solve.problem import largest_residual
from cosim.soft.solve.step_begin import fill_bed, fill_flight

_CALLED = (fill_bed, fill_flight, place_flight, substitute, largest_residual)
_BED, _FLIGHT, _PLACE, _SUBSTITUTE, _RESIDUAL = range(len(_CALLED))
_fill_bed, _fill_flight, _place_flight, _substitute, _largest_residual = map(caller, _CALLED)


def step_calls() -> IntArray:
    """Return the addresses (5,) of the kernels that a step calls besides those of the film's terms."""
    return np.array([address_of(called) for called in _CALLED])


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
    """Where a step begins, and where it ends: `new_...` are filled.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_x: one step earlier; of the first step: x.
        earlier_velocity: the same.
        memory: (values,), what the elements remember.
        flange: (4, 3), see `flange_axes`, at the end.
        new_x: (n, 3).
        new_velocity: (n, 3).
        new_memory: (values,).
    """

    x: Array
    velocity: Array
    earlier_x: Array
    earlier_velocity: Array
    memory: Array
    flange: Array
    new_x: Array
    new_velocity: Array
    new_memory: Array


class StepPlace(NamedTuple):
    """Where a call goes on.

    Args:
        begins: whether the step does; otherwise the end of the motion and the gradient are where it is.
        residual: there [N].
        energy: potential there [J].
        reuse_max: iterations at most.
    """

    begins: bool
    residual: float
    energy: float
    reuse_max: int


class StepWork(NamedTuple):
    """Scratch of a step; `gradient` holds what its end has.

    Args:
        calls: (5,), see `step_calls`.
        gradient: (n, 3) [N].
        solution: (1, n, 3).
        served: (n, 3) [m], the last point that serves.
        reference: (values,).
        pull: (segments,).
    """

    calls: IntArray
    gradient: Array
    solution: Array
    served: Array
    reference: Array
    pull: Array


class FilmSide(NamedTuple):
    """What the steps of one length of a film have in common.

    Args:
        film: its terms.
        bed: that inertia is; its target is filled anew by every step.
        kept: factorisation.
        held: by the flange.
        numbers: of the step.
        work: scratch.
    """

    film: FilmArrays
    bed: StepBed
    kept: KeptEnvelope
    held: HeldNodes
    numbers: StepNumbers
    work: StepWork


NUMBERS = types.NamedTuple((BOOLEAN, *(8 * [REAL])), StepNumbers)
PLACE = types.NamedTuple((BOOLEAN, REAL, REAL, types.int64), StepPlace)
KEPT = types.NamedTuple((BOOLEAN, VECTOR, PLACES, PLACES, VECTOR, INDICES, MATRIX, MASKS), KeptEnvelope)
MOTION = types.NamedTuple((*(4 * [MATRIX]), VECTOR, *(3 * [MATRIX]), VECTOR), StepMotion)
WORK = types.NamedTuple((INDICES, MATRIX, BLOCKS, MATRIX, VECTOR, VECTOR), StepWork)
FILM_SIDE = types.NamedTuple((FILM, BED, KEPT, HELD, NUMBERS, WORK), FilmSide)


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
    factor = kept.store, kept.start, kept.first, kept.inverse, kept.dofs
    _substitute(work.calls[_SUBSTITUTE], (*factor, turn, work.solution))
    for i in range(solution.shape[0]):
        for r in range(3):
            if math.isnan(solution[i, r]):
                return math.nan
            longest = max(longest, abs(solution[i, r]))
    return longest


@device_function
def _copy(values, to):  # type: ignore[no-untyped-def]
    """Copy values; a loop compiles in a fraction of the time of an assignment to a slice."""
    for i in range(values.shape[0]):
        to[i] = values[i]


@device_function
def _copy_rows(values, to):  # type: ignore[no-untyped-def]
    """Copy the rows of a matrix with three columns."""
    for i in range(values.shape[0]):
        for r in range(3):
            to[i, r] = values[i, r]


@device_function
def _begin(side, motion):  # type: ignore[no-untyped-def]
    """Fill base (as new velocity), target and start, and memories as they were."""
    x, velocity, before = motion.x, motion.velocity, motion.earlier_velocity
    base, work, numbers = motion.new_velocity, side.work, side.numbers
    calls, moved = work.calls, (x, velocity, motion.earlier_x, before)
    _fill_bed(calls[_BED], (*moved, numbers.two_steps, numbers.factor, base, side.bed.target))
    _fill_flight(calls[_FLIGHT], (x, velocity, before, numbers.h, numbers.fraction, motion.new_x))
    _place_flight(calls[_PLACE], (side.held, motion.flange, motion.new_x))
    _copy(motion.memory, motion.new_memory)


@device_function
def _move(place, change, x):  # type: ignore[no-untyped-def]
    """Fill x with a place that has changed."""
    for i in range(x.shape[0]):
        for r in range(3):
            x[i, r] = place[i, r] + change[i, r]


@device_function
def _end(x, base, span):  # type: ignore[no-untyped-def]
    """Replace base by the velocities."""
    for i in range(x.shape[0]):
        for r in range(3):
            base[i, r] = (x[i, r] - base[i, r]) / span


@kernel(types.Tuple((BOOLEAN, types.int64, REAL, REAL))(FILM_SIDE, PLAIN_LOADS, TOUCHED, MOTION, PLACE))
def film_step(side, loads, touched, motion, place):  # type: ignore[no-untyped-def]
    """Take a step, or go on; return (whether it has converged, iterations, residual [N], potential [J]).

    Fills the bed's target and the end of the motion, of a step that has not converged base instead of
    velocities; bed, motion and work say what they hold.
    """
    film, bed, kept, numbers, work = side.film, side.bed, side.kept, side.numbers, side.work
    turn, reference, x, tracked = np.empty((3, 3)), work.reference, motion.new_x, motion.new_memory
    if place.begins:
        _begin(side, motion)
    _turn_since(kept, motion.flange, turn)
    _copy(tracked, reference)
    _copy_rows(x, work.served)
    iterations, before, level, evaluated = 0, math.inf, math.inf, not place.begins
    bound = numbers.tolerance if evaluated else numbers.start_tolerance
    while True:
        if evaluated:
            residual, energy, serves, evaluated = place.residual, place.energy, True, False
        else:
            here = x, reference, work.pull, tracked, work.gradient
            energy = film_gradient(film, loads, touched, bed, *here)
            residual = _largest_residual(work.calls[_RESIDUAL], (x, work.gradient, kept.free))
            # a residual that does not fall enough asks for a new tangent
            serves = math.isfinite(energy) and residual <= numbers.reuse_rate * before
        if not serves:
            iterations -= 1
            break
        before, level = residual, energy
        _copy(tracked, reference)
        _copy_rows(x, work.served)
        if residual < bound:
            _end(x, motion.new_velocity, numbers.span)
            return True, iterations, residual, energy
        if not kept.there or iterations == place.reuse_max:
            break
        if not _solve(kept, turn, work) <= numbers.step_max:
            break
        _move(work.served, work.solution[0], x)
        iterations, bound = iterations + 1, numbers.tolerance
    _copy_rows(work.served, x)
    _copy(reference, tracked)
    return False, max(iterations, 0), before, level
