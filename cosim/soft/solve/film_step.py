"""One implicit step of a film in one kernel: its start, and iterations with a kept tangent or a new one.

It knows given pressures and tensions, and what the film may touch: the scene, and itself. Bodies side by side
that nothing couples are solved one by one, each by its own iterations with its own part of the factorisation.
Where an iteration does not serve, a new tangent is made at the point before it. Where that is not positive
definite, or not to be made here, the part is left there, and a further call goes on from a tangent of others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import IntArray
from cosim.base.kernels import BOOLEAN, REAL, address_of, device_function, kernel, small_matrix
from cosim.base.numba_insides import caller
from cosim.soft.beams.ring_kernels import REMEMBERED
from cosim.soft.body.loads import TOUCHING
from cosim.soft.film.film_arrays import BEAMS, BED, FILM, HINGES, NODES, FilmArrays, StepBed
from cosim.soft.film.film_terms import PLAIN_LOADS, film_terms
from cosim.soft.film.step_arrays import (
    ENERGY,
    LEFT,
    MOTION,
    NEW_TANGENTS,
    NUMBERS,
    PLACE,
    RESIDUAL,
    TANGENTS,
    TO_DO,
    WORK,
    NewTangents,
    StepNumbers,
    StepWork,
    copy,
    copy_rows,
    move,
)
from cosim.soft.linear.kept_envelope import KEPT, KeptEnvelope, count_extra, is_kept, renew, solve_kept
from cosim.soft.linear.secant_pairs import FAR, SecantPairs, keep_pair
from cosim.soft.solve.held_nodes import HELD, HeldNodes, place_flight, place_held
from cosim.soft.solve.problem import falls_enough, largest_residual
from cosim.soft.solve.step_begin import FOLD_SWEEPS, fill_bed, fill_flight, keep_folds_open

_CALLED = (
    fill_bed, fill_flight, place_flight, largest_residual, keep_pair, keep_folds_open, place_held, film_terms,
)  # fmt: skip
_BED, _FLIGHT, _PLACE, _RESIDUAL, _KEEP, _OPEN, _HOLD, _TERMS = range(len(_CALLED))
(
    _fill_bed, _fill_flight, _place_flight, _largest_residual, _keep_pair, _keep_folds_open, _place_held,
    _film_terms,
) = map(caller, _CALLED)  # fmt: skip


def step_calls() -> IntArray:
    """Return the addresses (8,) of the kernels that a step calls."""
    return np.array([address_of(called) for called in _CALLED])


class FilmSide(NamedTuple):
    """What the steps of one length of a film have in common.

    Args:
        film: its terms.
        bed: that inertia is; its target is filled anew by every step.
        kept: factorisation.
        tangents: where new ones are assembled.
        held: by the flange.
        numbers: of the step.
        work: scratch.
    """

    film: FilmArrays
    bed: StepBed
    kept: KeptEnvelope
    tangents: NewTangents
    held: HeldNodes
    numbers: StepNumbers
    work: StepWork


FILM_SIDE = types.NamedTuple((FILM, BED, KEPT, NEW_TANGENTS, HELD, NUMBERS, WORK), FilmSide)


@device_function
def _begin(side, motion):  # type: ignore[no-untyped-def]
    """Fill base (as new velocity), target and start, and memories as they were."""
    x, velocity, before = motion.x, motion.velocity, motion.earlier_velocity
    base, work, numbers = motion.new_velocity, side.work, side.numbers
    calls, moved = work.calls, (x, velocity, motion.earlier_x, before)
    _fill_bed(calls[_BED], (*moved, numbers.two_steps, numbers.factor, base, side.bed.target))
    _fill_flight(calls[_FLIGHT], (x, velocity, before, numbers.h, numbers.fraction, motion.new_x))
    _place_flight(calls[_PLACE], (side.held, motion.flange, motion.new_x))
    copy(motion.memory, motion.new_memory)


@device_function
def _copy_memory(film, part, values, to):  # type: ignore[no-untyped-def]
    """Copy what a part's elements remember."""
    hinges = film.angles[0]
    first, end = hinges + film.parts[part, HINGES], hinges + film.parts[part + 1, HINGES]
    copy(values[first:end], to[first:end])
    for k in range(film.parts[part, BEAMS], film.parts[part + 1, BEAMS]):
        group = film.beams.groups[k]
        first, end = group[3], group[3] + REMEMBERED * group[1] * group[2]
        copy(values[first:end], to[first:end])


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
def _terms(side, loads, touching, motion, slots, blocks, part):  # type: ignore[no-untyped-def]
    """Fill gradient, and blocks if slots are not empty, of a part at the end of the motion; see `film_terms`.

    Its elements remember the last point that serves.
    """
    film, work = side.film, side.work
    acting = loads, touching, side.bed, part, motion.new_x, work.reference
    filled = work.pull, motion.new_memory, work.gradient, blocks
    return _film_terms(work.calls[_TERMS], (film, slots, *acting, *filled))


@device_function
def _iterate(side, loads, touching, motion, turn, begins, part):  # type: ignore[no-untyped-def]
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
    copy_rows(x, place_there)
    served, pairs, before, level, evaluated = 0, 0, math.inf, math.inf, not begins
    moved = False
    bound, again = numbers.tolerance if evaluated else numbers.start_tolerance, False
    sweeps = FOLD_SWEEPS + 1 if begins else 0
    while True:
        if evaluated:
            residual, energy, evaluated = state[RESIDUAL], state[ENERGY], False
        else:
            energy = _terms(side, loads, touching, motion, film.no_slots, film.no_blocks, part)
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
            copy_rows(x, place_there)
            copy_rows(gradient, gradient_there)
            if residual < bound:
                state[TO_DO] = 0.0
                break
        elif again or pairs == known:
            break  # a new tangent is asked for
        else:
            again = True  # once more from there, by what the step has shown
        if served >= state[LEFT] or not is_kept(kept, begin, end):
            break
        ends = begin, end, work.served[1], work.solution
        if not solve_kept(kept, motion.flange, turn, secants, pairs, *ends) <= numbers.step_max:
            break
        move(place_there, 1.0, step, x)
        moved, bound = True, numbers.tolerance
    if state[TO_DO] != 0.0:
        copy_rows(place_there, x)
        _copy_memory(film, part, reference, tracked)
    state[LEFT], state[RESIDUAL], state[ENERGY] = state[LEFT] - served, before, level
    return served


@device_function
def _take_tangent(side, loads, touching, motion, turn, part):  # type: ignore[no-untyped-def]
    """Take a part one iteration with a new tangent on, as `NewtonSolver.with_tangent` does; return whether.

    None is taken where the tangent is not positive definite, or no share of its step serves.
    """
    film, kept, new, numbers, work = side.film, side.kept, side.tangents, side.numbers, side.work
    begin, end = film.parts[part, NODES], film.parts[part + 1, NODES]
    x, gradient = motion.new_x[begin:end], work.gradient[begin:end]
    here, step, state = work.served[0, begin:end], work.solution[0, begin:end], work.parts[part]
    new.blocks[new.first[part] : new.first[part + 1]] = 0.0
    _terms(side, loads, touching, motion, new.slots, new.blocks, part)
    if not renew(kept, new.blocks, motion.flange, begin, end):
        return False
    ends = begin, end, work.gradient, work.solution
    longest, slope = solve_kept(kept, motion.flange, turn, work.pairs, 0, *ends), 0.0
    for i in range(x.shape[0]):
        for r in range(3):
            slope += gradient[i, r] * step[i, r]
    share = numbers.step_max / longest if longest > numbers.step_max else 1.0
    for _ in range(numbers.halvings):
        move(here, share, step, x)
        energy = _terms(side, loads, touching, motion, film.no_slots, film.no_blocks, part)
        residual = _largest_residual(work.calls[_RESIDUAL], (x, gradient, kept.free[begin:end]))
        if falls_enough(energy, state[ENERGY], share * slope, residual, state[RESIDUAL]):
            state[TANGENTS], state[RESIDUAL], state[ENERGY] = state[TANGENTS] + 1.0, residual, energy
            return True
        share *= 0.5
    copy_rows(here, x)
    return False


@device_function
def _solve_part(side, loads, touching, motion, turn, place, part):  # type: ignore[no-untyped-def]
    """Solve a part until it has converged or cannot go on here; return iterations with a kept tangent."""
    served, state, begins = 0, side.work.parts[part], place.begins
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    while True:
        iterations = _iterate(side, loads, touching, motion, turn, begins, part)
        count_extra(side.kept, iterations, begin, end)
        served += iterations
        done, begins = state[TO_DO] == 0.0, False
        if done or state[TANGENTS] >= place.tangents_max or not math.isfinite(state[RESIDUAL]):
            return served
        if side.tangents.first.shape[0] == 0:
            return served
        if not _take_tangent(side, loads, touching, motion, turn, part):
            _copy_memory(side.film, part, side.work.reference, motion.new_memory)
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


@kernel(
    types.Tuple((BOOLEAN, types.int64, types.int64, REAL, REAL))(
        FILM_SIDE, PLAIN_LOADS, TOUCHING, MOTION, PLACE
    )
)
def film_step(side, loads, touching, motion, place):  # type: ignore[no-untyped-def]
    """Take a step, or go on; return whether it has converged, iterations, tangents, residual and potential.

    Iterations are those with a kept factorisation in this call, tangents the new ones in the whole step: of
    several parts the most. The residual [N] is the largest if it has not converged, the potential in J. Fills
    the bed's target and the end of the motion, of a step that has not converged base instead of velocities;
    bed, motion and work say what they hold.
    """
    work, numbers, count = side.work, side.numbers, side.film.parts.shape[0] - 1
    turn, x, parts = small_matrix(3, 3), motion.new_x, work.parts[:count]
    if place.begins:
        _begin(side, motion)
        _all_to_do(parts, place.reuse_max)
        parts[:, TANGENTS] = 0.0
    served, tangents, residual, energy, done = 0, 0, 0.0, 0.0, True
    for k in range(count):
        if parts[k, TO_DO] != 0.0:
            served = max(served, _solve_part(side, loads, touching, motion, turn, place, k))
        tangents = max(tangents, int(parts[k, TANGENTS]))
        residual, energy = max(residual, parts[k, RESIDUAL]), energy + parts[k, ENERGY]
        done = done and parts[k, TO_DO] == 0.0
    if done and count > 1:
        residual = _largest_residual(work.calls[_RESIDUAL], (x, work.gradient, side.kept.free))
        if not residual < numbers.tolerance:  # what is left of the parts adds up: once more, all of them
            _all_to_do(parts, place.reuse_max)
            done = False
    if done:
        _end(x, motion.new_velocity, numbers.span)
    return done, served, tangents, residual, energy
