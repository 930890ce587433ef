"""One implicit step of a film in one kernel: its start, and iterations with a factorisation that is kept.

It knows given pressures and tensions, and what the film may touch: the scene, and itself. Bodies side by side
that nothing couples are solved one by one, each by its own iterations with its own part of the factorisation.
Where an iteration does not serve, the part is left at the point before it: a new tangent is asked for there,
from which a further call goes on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import IntArray
from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import BOOLEAN, REAL, device_function, kernel
from cosim.base.small_arrays import small_matrix
from cosim.soft.beams.ring_kernels import REMEMBERED
from cosim.soft.body.loads import TOUCHING
from cosim.soft.film.film_arrays import BEAMS, BED, FILM, HINGES, NODES, FilmArrays, StepBed
from cosim.soft.film.film_terms import PLAIN_LOADS, film_terms
from cosim.soft.linear.envelope_cholesky import NODE, SOLVED, STORED, TILED
from cosim.soft.linear.envelope_kernels import substitute
from cosim.soft.linear.secant_pairs import FAR, SecantPairs, bend_load, keep_pair, mend_step
from cosim.soft.solve.held_nodes import HELD, HeldNodes, place_flight, place_held
from cosim.soft.solve.problem import largest_residual
from cosim.soft.solve.step_arrays import (
    ENERGY,
    KEPT,
    LEFT,
    MOTION,
    NUMBERS,
    PLACE,
    RESIDUAL,
    TO_DO,
    WORK,
    KeptEnvelope,
    StepNumbers,
    StepWork,
)
from cosim.soft.solve.step_begin import FOLD_SWEEPS, fill_bed, fill_flight, keep_folds_open

_CALLED = (
    fill_bed, fill_flight, place_flight, substitute, largest_residual, bend_load, mend_step, keep_pair,
    keep_folds_open, place_held, film_terms,
)  # fmt: skip
_BED, _FLIGHT, _PLACE, _SUBSTITUTE, _RESIDUAL, _BEND, _MEND, _KEEP, _OPEN, _HOLD, _TERMS = range(len(_CALLED))
(
    _fill_bed, _fill_flight, _place_flight, _substitute, _largest_residual, _bend_load, _mend_step,
    _keep_pair, _keep_folds_open, _place_held, _film_terms,
) = map(caller, _CALLED)  # fmt: skip


def step_calls() -> IntArray:
    """Return the addresses (11,) of the kernels that a step calls."""
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
def _turn_since(frame, flange, turn):  # type: ignore[no-untyped-def]
    """Fill turn (3, 3) with the rotation from the axes (3, 3) of a factorisation to the flange's."""
    for r in range(3):
        for c in range(3):
            turn[r, c] = 0.0
            for k in range(3):
                turn[r, c] += flange[1 + k, r] * frame[c, k]


@device_function
def _is_kept(kept, begin, end):  # type: ignore[no-untyped-def]
    """Return whether the factorisation of nodes begin to end is there."""
    for k in range(kept.there.shape[0]):
        first, last = kept.factor.parts[k, NODE], kept.factor.parts[k + 1, NODE]
        beyond = first < begin or end < last or kept.there[k] == 0
        if first < end and begin < last and beyond:
            return False
    return True


@device_function
def _solve(kept, flange, turn, pairs, count, work, begin, end):  # type: ignore[no-untyped-def]
    """Fill the solution of nodes begin to end, corrected by some pairs; return its largest component.

    NaN if one is none.
    """
    solution, longest, factor = work.solution[0, begin:end], 0.0, kept.factor
    _bend_load(work.calls[_BEND], (pairs, count, work.served[1, begin:end], solution))
    for k in range(kept.there.shape[0]):
        a, b = factor.parts[k], factor.parts[k + 1]
        if not begin <= a[NODE] < end:
            continue
        _turn_since(kept.frame[k], flange, turn)
        own = work.solution[0, a[NODE] : b[NODE]].reshape((1, b[NODE] - a[NODE], 3))
        _substitute(
            work.calls[_SUBSTITUTE],
            (
                factor.store[a[STORED] : b[STORED]], factor.start[a[TILED] : b[TILED]],
                factor.first[a[TILED] : b[TILED]], factor.inverse[4 * a[TILED] : 4 * b[TILED]],
                factor.dofs[a[SOLVED] : b[SOLVED]], turn, own,
            ),
        )  # fmt: skip
    _mend_step(work.calls[_MEND], (pairs, count, solution))
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
def _copy_memory(film, part, values, to):  # type: ignore[no-untyped-def]
    """Copy what a part's elements remember."""
    hinges = film.angles[0]
    first, end = hinges + film.parts[part, HINGES], hinges + film.parts[part + 1, HINGES]
    _copy(values[first:end], to[first:end])
    for k in range(film.parts[part, BEAMS], film.parts[part + 1, BEAMS]):
        group = film.beams.groups[k]
        first, end = group[3], group[3] + REMEMBERED * group[1] * group[2]
        _copy(values[first:end], to[first:end])


@device_function
def _opens_folds(side, motion, part):  # type: ignore[no-untyped-def]
    """Take nodes of a part's folds that close out of their flight; return whether there are any."""
    film, calls = side.film, side.work.calls
    first, end = film.parts[part, HINGES], film.parts[part + 1, HINGES]
    hinges, begin = film.hinges[first:end], film.angles[0]
    angles = motion.memory[begin + first : begin + end], motion.new_memory[begin + first : begin + end]
    if not _keep_folds_open(calls[_OPEN], (motion.x, hinges, film.fold_barrier[0], *angles, motion.new_x)):
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
def _solve_part(side, loads, touching, motion, turn, begins, part):  # type: ignore[no-untyped-def]
    """Solve a part until it has converged or a new tangent is asked for; return the iterations."""
    film, kept, numbers, work = side.film, side.kept, side.numbers, side.work
    begin, end = film.parts[part, NODES], film.parts[part + 1, NODES]
    x, tracked, reference = motion.new_x[begin:end], motion.new_memory, work.reference
    gradient, free, step = work.gradient[begin:end], kept.free[begin:end], work.solution[0, begin:end]
    place_there, gradient_there = work.served[0, begin:end], work.served[1, begin:end]
    room, state = work.pairs.scale.shape[0], work.parts[part]
    own, size = 3 * room * begin, 3 * (end - begin)
    secants = SecantPairs(
        work.pairs.step.reshape(-1)[own : own + room * size].reshape((room, size)),
        work.pairs.change.reshape(-1)[own : own + room * size].reshape((room, size)),
        work.pairs.scale, work.pairs.share,
    )  # fmt: skip
    _copy_memory(film, part, tracked, reference)
    _copy_rows(x, place_there)
    served, pairs, before, level, evaluated = 0, 0, math.inf, math.inf, not begins
    moved = False
    bound, again = numbers.tolerance if evaluated else numbers.start_tolerance, False
    sweeps = FOLD_SWEEPS + 1 if begins else 0
    while True:
        if evaluated:
            residual, energy, evaluated = state[RESIDUAL], state[ENERGY], False
        else:
            acting = loads, touching, side.bed, part, motion.new_x, reference
            filled = work.pull, tracked, work.gradient, film.no_blocks
            energy = _film_terms(work.calls[_TERMS], (film, film.no_slots, *acting, *filled))
            residual = _largest_residual(work.calls[_RESIDUAL], (x, gradient, free))
        sweeps -= 1
        if sweeps > 0 and _opens_folds(side, motion, part):
            continue
        sweeps = 0
        finite, known = math.isfinite(energy) and math.isfinite(residual), pairs
        if moved and finite and residual <= FAR * before:
            pairs = _keep_pair(work.calls[_KEEP], (secants, pairs, step, gradient_there, gradient, free))
        if finite and residual <= numbers.reuse_rate * before:
            before, level, again, served = residual, energy, False, served + moved
            _copy_memory(film, part, tracked, reference)
            _copy_rows(x, place_there)
            _copy_rows(gradient, gradient_there)
            if residual < bound:
                state[TO_DO] = 0.0
                break
        elif again or pairs == known:
            break  # a new tangent is asked for
        else:
            again = True  # once more from there, by what the step has shown
        if served >= state[LEFT] or not _is_kept(kept, begin, end):
            break
        if not _solve(kept, motion.flange, turn, secants, pairs, work, begin, end) <= numbers.step_max:
            break
        _move(place_there, step, x)
        moved, bound = True, numbers.tolerance
    if state[TO_DO] != 0.0:
        _copy_rows(place_there, x)
        _copy_memory(film, part, reference, tracked)
    state[LEFT], state[RESIDUAL], state[ENERGY] = state[LEFT] - served, before, level
    return served


@device_function
def _all_to_do(parts, left):  # type: ignore[no-untyped-def]
    """Let all parts be solved, in so many iterations."""
    for k in range(parts.shape[0]):
        parts[k, TO_DO], parts[k, LEFT] = 1.0, left


@device_function
def _end(x, base, span):  # type: ignore[no-untyped-def]
    """Replace base by the velocities."""
    for i in range(x.shape[0]):
        for r in range(3):
            base[i, r] = (x[i, r] - base[i, r]) / span


@kernel(types.Tuple((BOOLEAN, types.int64, REAL, REAL))(FILM_SIDE, PLAIN_LOADS, TOUCHING, MOTION, PLACE))
def film_step(side, loads, touching, motion, place):  # type: ignore[no-untyped-def]
    """Take a step, or go on; return (whether it has converged, iterations, residual [N], potential [J]).

    Of several parts the most iterations, and the largest residual if it has not converged. Fills the bed's
    target and the end of the motion, of a step that has not converged base instead of velocities; bed, motion
    and work say what they hold.
    """
    work, numbers, count = side.work, side.numbers, side.film.parts.shape[0] - 1
    turn, x, parts = small_matrix(3, 3), motion.new_x, work.parts[:count]
    if place.begins:
        _begin(side, motion)
        _all_to_do(parts, place.reuse_max)
    served, residual, energy, done = 0, 0.0, 0.0, True
    for k in range(count):
        if parts[k, TO_DO] != 0.0:
            served = max(served, _solve_part(side, loads, touching, motion, turn, place.begins, k))
        residual, energy = max(residual, parts[k, RESIDUAL]), energy + parts[k, ENERGY]
        done = done and parts[k, TO_DO] == 0.0
    if done and count > 1:
        residual = _largest_residual(work.calls[_RESIDUAL], (x, work.gradient, side.kept.free))
        if not residual < numbers.tolerance:  # what is left of the parts adds up: once more, all of them
            _all_to_do(parts, place.reuse_max)
            done = False
    if done:
        _end(x, motion.new_velocity, numbers.span)
    return done, served, residual, energy
