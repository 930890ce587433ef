"""One implicit step of a film in one kernel: its start, and iterations with a factorisation that is kept.

It knows given pressures and tensions, and what the film may touch: the scene, and itself. Where an iteration
does not serve, the step is left at the point before it: a new tangent is asked for there, from which a
further call goes on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import IntArray
from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import BOOLEAN, REAL, device_function, kernel
from cosim.soft.body.loads import TOUCHING
from cosim.soft.linear.envelope_kernels import substitute
from cosim.soft.linear.secant_pairs import FAR, bend_load, keep_pair, mend_step
from cosim.soft.solve.film_arrays import BED, FILM, PLAIN_LOADS, FilmArrays, StepBed, film_gradient
from cosim.soft.solve.held_nodes import HELD, HeldNodes, place_flight, place_held
from cosim.soft.solve.problem import largest_residual
from cosim.soft.solve.step_arrays import (
    KEPT,
    MOTION,
    NUMBERS,
    PLACE,
    WORK,
    KeptEnvelope,
    StepNumbers,
    StepWork,
)
from cosim.soft.solve.step_begin import FOLD_SWEEPS, fill_bed, fill_flight, keep_folds_open

_CALLED = (
    fill_bed, fill_flight, place_flight, substitute, largest_residual, bend_load, mend_step, keep_pair,
    keep_folds_open, place_held,
)  # fmt: skip
_BED, _FLIGHT, _PLACE, _SUBSTITUTE, _RESIDUAL, _BEND, _MEND, _KEEP, _OPEN, _HOLD = range(len(_CALLED))
(
    _fill_bed, _fill_flight, _place_flight, _substitute, _largest_residual, _bend_load, _mend_step,
    _keep_pair, _keep_folds_open, _place_held,
) = map(caller, _CALLED)  # fmt: skip


def step_calls() -> IntArray:
    """Return the addresses (10,) of the kernels that a step calls besides those of the film's terms."""
    return np.array([address_of(called) for called in _CALLED])


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
def _solve(kept, turn, count, work):  # type: ignore[no-untyped-def]
    """Fill the solution, corrected by some pairs; return its largest component, NaN if one is none."""
    solution, longest = work.solution[0], 0.0
    _bend_load(work.calls[_BEND], (work.pairs, count, work.served[1], solution))
    factor = kept.store, kept.start, kept.first, kept.inverse, kept.dofs
    _substitute(work.calls[_SUBSTITUTE], (*factor, turn, work.solution))
    _mend_step(work.calls[_MEND], (work.pairs, count, solution))
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
def _opens_folds(side, motion):  # type: ignore[no-untyped-def]
    """Take nodes of folds that close out of their flight; return whether there are any."""
    film, calls = side.film, side.work.calls
    first, end = film.angles[0], film.angles[1]
    angles = motion.memory[first:end], motion.new_memory[first:end]
    if not _keep_folds_open(
        calls[_OPEN], (motion.x, film.hinges, film.fold_barrier[0], *angles, motion.new_x)
    ):
        return False
    _place_held(calls[_HOLD], (side.held, motion.flange, motion.new_x))
    return True


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


@kernel(types.Tuple((BOOLEAN, types.int64, REAL, REAL))(FILM_SIDE, PLAIN_LOADS, TOUCHING, MOTION, PLACE))
def film_step(side, loads, touching, motion, place):  # type: ignore[no-untyped-def]
    """Take a step, or go on; return (whether it has converged, iterations, residual [N], potential [J]).

    Fills the bed's target and the end of the motion, of a step that has not converged base instead of
    velocities; bed, motion and work say what they hold.
    """
    film, bed, kept, numbers, work = side.film, side.bed, side.kept, side.numbers, side.work
    turn, reference, x, tracked = np.empty((3, 3)), work.reference, motion.new_x, motion.new_memory
    place_there, gradient_there, step = work.served[0], work.served[1], work.solution[0]
    if place.begins:
        _begin(side, motion)
    _turn_since(kept, motion.flange, turn)
    _copy(tracked, reference)
    _copy_rows(x, place_there)
    served, pairs, before, level, evaluated = 0, 0, math.inf, math.inf, not place.begins
    moved = False
    bound, again = numbers.tolerance if evaluated else numbers.start_tolerance, False
    sweeps = FOLD_SWEEPS + 1 if place.begins else 0
    while True:
        if evaluated:
            residual, energy, evaluated = place.residual, place.energy, False
        else:
            here = x, reference, work.pull, tracked, work.gradient
            energy = film_gradient(film, loads, touching, bed, *here)
            residual = _largest_residual(work.calls[_RESIDUAL], (x, work.gradient, kept.free))
        sweeps -= 1
        if sweeps > 0 and _opens_folds(side, motion):
            continue
        sweeps = 0
        finite, known = math.isfinite(energy) and math.isfinite(residual), pairs
        if moved and finite and residual <= FAR * before:
            ends = step, gradient_there, work.gradient, kept.free
            pairs = _keep_pair(work.calls[_KEEP], (work.pairs, pairs, *ends))
        if finite and residual <= numbers.reuse_rate * before:
            before, level, again, served = residual, energy, False, served + moved
            _copy(tracked, reference)
            _copy_rows(x, place_there)
            _copy_rows(work.gradient, gradient_there)
            if residual < bound:
                _end(x, motion.new_velocity, numbers.span)
                return True, served, residual, energy
        elif again or pairs == known:
            break  # a new tangent is asked for
        else:
            again = True  # once more from there, by what the step has shown
        if not kept.there or served == place.reuse_max:
            break
        if not _solve(kept, turn, pairs, work) <= numbers.step_max:
            break
        _move(place_there, step, x)
        moved, bound = True, numbers.tolerance
    _copy_rows(place_there, x)
    _copy(reference, tracked)
    return False, served, before, level
