"""Newton's method on the potential of a film, in one kernel: statics, and implicit steps as they begin.

Each iteration solves (K + mu 1) d = -gradient. A new tangent is made at the point before; mu is zero while K
is positive definite, and found by who calls otherwise (inertia correction). The step along it is halved
until the potential falls, or, for loads without one, the work of the out-of-balance force along the step. The
factor of an earlier iteration may be used for a while, turned with the flange and corrected by what its steps
have shown (`secant_pairs`): an iteration with it costs a tenth, undone when the residual does not fall. Once
those beyond one a solution have cost as much as a new one, it is made.

Bodies side by side that nothing couples are solved one by one, each by its own iterations with its own part
of the factorisation. What the kernel cannot do by itself it asks for (`step_arrays`), and continues from
there. Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 3.4 and 3.5.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernel_types import Blocks, Masks, Matrix, Vector
from cosim.base.kernels import (
    address_of,
    copy,
    copy_rows,
    device_function,
    handing_on_views,
    kernel,
    record_at,
    small_matrix,
)
from cosim.base.numba_insides import caller
from cosim.soft.beams.ring_kernels import REMEMBERED
from cosim.soft.body.loads import PlainLoads, Touching
from cosim.soft.contact.self_contact_pairs import add_pair_blocks
from cosim.soft.elements.eyelets import SHARE as FROZEN_SHARE
from cosim.soft.elements.eyelets import freeze_losses
from cosim.soft.elements.open_caps import RimArrays, correct_rims, hold_rims
from cosim.soft.film.film_terms import FilmActing, film_terms
from cosim.soft.film.rate_kernels import fill_rates
from cosim.soft.film.step_arrays import (
    AGAIN,
    ASKS,
    BEAMS,
    BEGINS_STEP,
    ENERGY,
    EVALUATED,
    EVALUATION,
    GOES_ON,
    HINGES,
    LEFT,
    MOVED,
    NODES,
    NOTHING,
    PAIRS_KNOWN,
    PATTERN,
    RESIDUAL,
    RUN,
    SEARCHES,
    SEGMENTS,
    SHARE,
    SLOPE,
    SOLUTION,
    SOLVED,
    STUCK,
    SWEEPS,
    TANGENT,
    TANGENTS,
    TO_DO,
    TRIED,
    TRIES,
    WIDENED,
    FilmArrays,
    FilmPoint,
    NewTangents,
    StepBed,
    StepMotion,
    StepNumbers,
    StepPlace,
    StepRates,
    StepWork,
    move,
)
from cosim.soft.linear.kept_factor import OUTSIDE, KeptEnvelope, count_extra, is_kept, renew, solve_kept
from cosim.soft.linear.pattern import SPARE
from cosim.soft.linear.secant_pairs import FAR, SecantPairs, keep_pair
from cosim.soft.solve.state import HeldNodes, follow_flange, place_flight, place_held
from cosim.soft.solve.step_begin import FOLD_SWEEPS, BedNumbers, fill_bed, fill_flight, keep_folds_open

RESULTANT_SHARE: Final = 1e-2
"""Of the resultant force, or of the moment over the body's size, that counts as a residual."""

_MUCH_LESS: Final = 0.1
"""Share of a residual to which a step has to bring it that does not lower the potential."""
_TRY, _DIRECT, _RENEW, _STOP = range(4)  # what a part does next


@kernel
def largest_residual(x: Matrix, values: Matrix, counted: Masks) -> float:
    """Return the largest component of those counted, or the share of their resultant where that is larger.

    Many small forces of one sign add up to a wrench that is not there. NaN if a component is not a number.
    """
    largest, size = 0.0, 0.0
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(values.shape[0]):
        gx = values[i, 0] if counted[i, 0] else 0.0
        gy = values[i, 1] if counted[i, 1] else 0.0
        gz = values[i, 2] if counted[i, 2] else 0.0
        most = max(abs(gx), abs(gy), abs(gz))
        if gx != gx or gy != gy or gz != gz:
            return math.nan
        largest = max(largest, most)
        rx, ry, rz = x[i, 0] - x[0, 0], x[i, 1] - x[0, 1], x[i, 2] - x[0, 2]
        size = max(size, rx * rx + ry * ry + rz * rz)
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        mx, my, mz = mx + ry * gz - rz * gy, my + rz * gx - rx * gz, mz + rx * gy - ry * gx
    force, moment = math.sqrt(fx * fx + fy * fy + fz * fz), math.sqrt(mx * mx + my * my + mz * mz)
    if size > 0.0:
        force = max(force, moment / math.sqrt(size))
    return max(largest, RESULTANT_SHARE * force)


_CALLED = (
    fill_bed, fill_flight, place_flight, largest_residual, keep_pair, keep_folds_open, place_held, film_terms,
    freeze_losses, follow_flange,
)  # fmt: skip
_BED, _FLIGHT, _PLACE, _RESIDUAL, _KEEP, _OPEN, _HOLD, _TERMS, _FREEZE, _FOLLOW = range(len(_CALLED))
(
    _fill_bed, _fill_flight, _place_flight, _largest_residual, _keep_pair, _keep_folds_open, _place_held,
    _film_terms, _freeze_losses, _follow_flange,
) = map(caller, _CALLED)  # fmt: skip
_add_pair_blocks = caller(add_pair_blocks)
_fill_rates = caller(fill_rates)


def step_calls() -> IntArray:
    """Return the addresses (10,) of the kernels that a step calls."""
    return np.array([address_of(called) for called in _CALLED])


class FilmSide(NamedTuple):
    """What the steps of one length of a film have in common.

    Args:
        film: its terms.
        bed: that inertia is; its target is filled again by every step.
        kept: factorisation.
        tangents: where new ones are assembled.
        held: by the flange.
        numbers: of the step.
        work: scratch.
        rims: of a body with open ends, where the kernel makes its tangents; otherwise empty.
    """

    film: FilmArrays
    bed: StepBed
    kept: KeptEnvelope
    tangents: NewTangents
    held: HeldNodes
    numbers: StepNumbers
    work: StepWork
    rims: RimArrays


@device_function
def _copy_memory(film: FilmArrays, part: int, values: Vector, to: Vector) -> None:
    """Copy what a part's elements remember; of one part all, what kernels do not know included."""
    if film.parts.shape[0] == 2:
        copy(values, to)
        return
    hinges = film.angles[0]
    first, end = hinges + film.parts[part, HINGES], hinges + film.parts[part + 1, HINGES]
    copy(values[first:end], to[first:end])
    for s in range(film.parts[part, SEGMENTS], film.parts[part + 1, SEGMENTS]):
        place = film.eyelets.places[s]
        if place >= 0:
            to[place] = values[place]
    for k in range(film.parts[part, BEAMS], film.parts[part + 1, BEAMS]):
        group = film.beams.groups[k]
        first, end = group[3], group[3] + REMEMBERED * group[1] * group[2]
        copy(values[first:end], to[first:end])


@device_function
def _opens_folds(side: FilmSide, motion: Any, part: int) -> bool:
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
def _terms(side: FilmSide, acting: FilmActing, motion: Any, slots: Any, blocks: Blocks, part: int) -> float:
    """Fill gradient, and blocks if slots are not empty, of a part at the end of the motion; see `film_terms`.

    Its elements remember the last point that serves.
    """
    work = side.work
    point = FilmPoint(motion.new_x, work.reference, motion.new_memory, work.gradient, blocks, work.pull)
    return _film_terms(work.calls[_TERMS], (work.film, slots, acting, part, point))


@handing_on_views
def _own(work: StepWork, begin: int, end: int) -> SecantPairs:
    """Return the pairs of steps of a part's nodes, each in one stretch."""
    room, size = work.pairs.scale.shape[0], 3 * (end - begin)
    own = 3 * room * begin
    return SecantPairs(
        work.pairs.step.reshape(-1)[own : own + room * size].reshape((room, size)),
        work.pairs.change.reshape(-1)[own : own + room * size].reshape((room, size)),
        work.pairs.scale, work.pairs.share,
    )  # fmt: skip


@device_function
def _accept(side: FilmSide, motion: Any, part: int, residual: float) -> int:
    """Let the point that is tried be the one that serves; return what is next."""
    work, numbers, state = side.work, side.numbers, side.work.parts[part]
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    state[RESIDUAL], state[ENERGY], state[AGAIN] = residual, state[TRIED], 0.0
    _copy_memory(side.film, part, motion.new_memory, work.reference)
    copy_rows(motion.new_x[begin:end], work.served[0, begin:end])
    copy_rows(work.gradient[begin:end], work.served[1, begin:end])
    # many small forces of one sign add up: a start is accepted by the stricter bound only
    begins = state[MOVED] == 0.0 and state[TANGENTS] == 0.0
    if residual < (numbers.start_tolerance if begins else numbers.tolerance):
        count_extra(side.kept, state[RUN], begin, end)
        state[TO_DO] = 0.0
        return _STOP
    return _DIRECT


@device_function
def _judge_kept(side: FilmSide, motion: Any, part: int, residual: float) -> int:
    """Judge a step with a kept factorisation, or a start; return what is next."""
    work, numbers, state = side.work, side.numbers, side.work.parts[part]
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    finite, known, before = (
        math.isfinite(state[TRIED]) and math.isfinite(residual),
        int(state[PAIRS_KNOWN]),
        state[RESIDUAL],
    )
    if state[MOVED] != 0.0 and finite and residual <= FAR * before and numbers.potential:
        ends = work.solution[0, begin:end], work.served[1, begin:end], work.gradient[begin:end]
        shown = _own(work, begin, end), known, *ends, side.kept.free[begin:end]
        state[PAIRS_KNOWN] = _keep_pair(work.calls[_KEEP], shown)
    # rounding may keep a residual from falling that the step's own bound accepts
    done = state[MOVED] != 0.0 and residual < numbers.tolerance
    if finite and (done or residual <= numbers.reuse_rate * before):
        state[RUN], state[LEFT] = state[RUN] + state[MOVED], state[LEFT] - state[MOVED]
        return _accept(side, motion, part, residual)
    if state[AGAIN] != 0.0 or state[PAIRS_KNOWN] == known:
        return _RENEW
    state[AGAIN] = 1.0  # once more from there, by what the step has shown
    return _DIRECT


@device_function
def _along(force: Matrix, step: Matrix, begin: int, end: int) -> float:
    """Return the work of a force along a step of some nodes."""
    work = 0.0
    for i in range(begin, end):
        for r in range(3):
            work += force[i, r] * step[i, r]
    return work


@device_function
def _judge_search(side: FilmSide, motion: Any, part: int, residual: float) -> int:
    """Judge a share of a step along a new tangent; return what is next.

    It serves if it lowers the potential, or the residual by far. Without a potential the work of the
    out-of-balance force along the step counts (Crisfield's line search), of which a short step takes little
    away.
    """
    work, state = side.work, side.work.parts[part]
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    energy, before, share = state[TRIED], state[ENERGY], state[SHARE]
    if side.numbers.potential:
        rounding = 1e-13 * (1.0 + abs(before))  # what it can hide in a sum of terms of this size
        serves = energy <= before + 1e-4 * (share * state[SLOPE]) + rounding
    else:
        force = _along(work.gradient, work.solution[0], begin, end)
        serves = abs(force) <= (1.0 - 0.1 * share) * abs(state[SLOPE]) and math.isfinite(energy)
    if serves or (math.isfinite(energy) and residual < _MUCH_LESS * state[RESIDUAL]):
        state[TANGENTS] += 1.0
        state[SEARCHES] = state[PAIRS_KNOWN] = state[MOVED] = state[RUN] = 0.0
        return _accept(side, motion, part, residual)
    state[TRIES], state[SHARE] = state[TRIES] - 1.0, 0.5 * state[SHARE]
    if state[TRIES] > 0.0:
        move(work.served[0, begin:end], state[SHARE], work.solution[0, begin:end], motion.new_x[begin:end])
        return _TRY
    _go_back(side, motion, part)
    state[ASKS], state[SEARCHES] = STUCK, 0.0
    return _STOP


@device_function
def _go_back(side: FilmSide, motion: Any, part: int) -> None:
    """Bring the end of the motion to the last point that serves."""
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    copy_rows(side.work.served[0, begin:end], motion.new_x[begin:end])
    _copy_memory(side.film, part, side.work.reference, motion.new_memory)


@device_function
def _follow(side: FilmSide, motion: Any, part: int, longest: float) -> int:
    """Try a step whose largest component is known; return what is next."""
    work, numbers, state = side.work, side.numbers, side.work.parts[part]
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    here, step, x = work.served[0, begin:end], work.solution[0, begin:end], motion.new_x[begin:end]
    if state[SEARCHES] == 0.0:
        if not longest <= numbers.step_max:
            return _RENEW
        state[MOVED] = 1.0
        move(here, 1.0, step, x)
        return _TRY
    state[SLOPE], state[TRIES] = _along(work.gradient, work.solution[0], begin, end), numbers.halvings
    state[SHARE] = numbers.step_max / longest if longest > numbers.step_max else 1.0
    move(here, state[SHARE], step, x)
    return _TRY


@device_function
def _direct(side: FilmSide, motion: Any, turn: Matrix, part: int) -> int:
    """Take a step with a kept factorisation if there is one that may serve; return what is next."""
    work, kept, state = side.work, side.kept, side.work.parts[part]
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    near = state[RESIDUAL] < side.numbers.reuse_below
    if not near or state[LEFT] <= 0.0 or not is_kept(kept, begin, end):
        return _RENEW
    if kept.there[0] == OUTSIDE:
        state[ASKS] = SOLUTION
        return _STOP
    pairs, known, load = _own(work, begin, end), int(state[PAIRS_KNOWN]), work.served[1]
    axes, nodes = (motion.flange, turn), (begin, end)
    largest = solve_kept(kept, axes, (pairs, known), nodes, load, work.solution)
    return _follow(side, motion, part, largest)


@device_function
def _fill_wide(new: NewTangents, acting: FilmActing, x: Matrix) -> bool:
    """Fill the tangent where films may touch one another; return whether the pattern serves it.

    Not where it lacks a block, or has many that serve neither the body nor pairs that press or rub.
    """
    wide, pairs, acts = new.wide, acting.touching.pairs, False
    if acting.touching.call != 0:
        for e in range(pairs.friction.shape[0]):
            acts = acts or pairs.out[e, 0] > 0.0 or pairs.friction[e] > 0.0
    if not acts or wide.call == 0:
        return not acts and wide.call == 0
    for s in range(wide.of_body.shape[0]):
        own = wide.of_body[s]
        wide.used[s] = own >= 0
        for r in range(3):
            for c in range(3):
                wide.blocks[s, r, c] = new.blocks[own, r, c] if own >= 0 else 0.0
    if _add_pair_blocks(wide.call, (x, pairs, wide.rows, wide.used, wide.blocks)) > 0:
        return False
    used = 0
    for s in range(wide.used.shape[0]):
        used += wide.used[s]
    return not wide.used.shape[0] > SPARE * used


@device_function
def _renew(side: FilmSide, acting: FilmActing, motion: Any, turn: Matrix, place: Any, part: int) -> int:
    """Take a step with a new tangent where the last point serves; return what is next."""
    kept, new, work, state = side.kept, side.tangents, side.work, side.work.parts[part]
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    filled = state[ASKS] == WIDENED
    count_extra(kept, state[RUN], begin, end)
    state[RUN], state[ASKS] = 0.0, NOTHING
    _go_back(side, motion, part)
    if state[TANGENTS] >= place.tangents_max or not math.isfinite(state[RESIDUAL]):
        return _STOP
    state[ASKS] = TANGENT
    if new.first.shape[0] == 0 or not side.numbers.complete:
        return _STOP
    if not filled:
        new.blocks[new.first[part] : new.first[part + 1]] = 0.0
        _terms(side, acting, motion, new.slots, new.blocks, part)
    fits = _fill_wide(new, acting, motion.new_x)
    state[ASKS] = TANGENT if fits else PATTERN
    blocks = new.wide.blocks if new.wide.call != 0 else new.blocks
    if fits:
        hold_rims(side.rims, blocks)
    rims, chambers = side.rims, side.film.chambers
    definite = fits and renew(kept, blocks, motion.flange, begin, end)
    if definite and rims.nodes.shape[0] > 0:  # what open ends have beside the factorisation
        for k in range(chambers.shape[0] - 1):
            for cap in range(chambers[k, 1], chambers[k + 1, 1]):
                rims.pressure[cap] = acting.more.found[k, 0]
        definite = correct_rims(rims, kept, motion.new_x)
        kept.there[0] = definite
    if not definite:
        _go_back(side, motion, part)
        return _STOP
    state[ASKS], state[SEARCHES] = NOTHING, 1.0
    axes, pairs = (motion.flange, turn), _own(work, begin, end)
    largest = solve_kept(kept, axes, (pairs, 0), (begin, end), work.gradient, work.solution)
    return _follow(side, motion, part, largest)


@device_function
def _evaluate(side: FilmSide, acting: FilmActing, motion: Any, part: int) -> bool:
    """Find the potential where a part is to be tried; return whether it is known."""
    state, film = side.work.parts[part], side.film
    if state[ASKS] != EVALUATED:
        if not side.numbers.complete:
            state[ASKS] = EVALUATION
            return False
        state[TRIED] = _terms(side, acting, motion, film.no_slots, film.no_blocks, part)
    state[ASKS] = NOTHING
    return True


@device_function
def _solve_part(side: FilmSide, acting: FilmActing, motion: Any, turn: Matrix, place: Any, part: int) -> None:
    """Iterate a part until it has converged, asks for something or cannot continue."""
    state, work = side.work.parts[part], side.work
    begin, end = side.film.parts[part, NODES], side.film.parts[part + 1, NODES]
    following = _TRY
    if state[ASKS] == SOLVED:
        state[ASKS], longest = NOTHING, 0.0
        for i in range(begin, end):
            for r in range(3):
                longest = max(longest, abs(work.solution[0, i, r]))
        following = _follow(side, motion, part, longest)
    elif state[ASKS] == TANGENT or state[ASKS] == PATTERN or state[ASKS] == WIDENED:
        following = _RENEW
    elif state[ASKS] != EVALUATED and place.begins == GOES_ON:
        return
    while following != _STOP:
        if following == _DIRECT:
            following = _direct(side, motion, turn, part)
        elif following == _RENEW:
            following = _renew(side, acting, motion, turn, place, part)
        else:
            if not _evaluate(side, acting, motion, part):
                return
            residual = _largest_residual(
                work.calls[_RESIDUAL],
                (motion.new_x[begin:end], work.gradient[begin:end], side.kept.free[begin:end]),
            )
            state[SWEEPS] -= 1.0
            if state[SWEEPS] > 0.0 and _opens_folds(side, motion, part):
                continue
            state[SWEEPS] = 0.0
            if state[SEARCHES] != 0.0:
                following = _judge_search(side, motion, part, residual)
            else:
                following = _judge_kept(side, motion, part, residual)


@device_function
def _prepare(side: FilmSide, tension: Vector, motion: Any, place: Any) -> None:
    """Let all parts be solved from where the motion ends, or a step from where it begins."""
    work, numbers, steps = side.work, side.numbers, place.begins == BEGINS_STEP
    if steps:
        x, velocity, before, calls = motion.x, motion.velocity, motion.earlier_velocity, work.calls
        base, moved = motion.new_velocity, (x, velocity, motion.earlier_x, before)
        rates = BedNumbers(numbers.two_steps, numbers.span, numbers.factor, numbers.share)
        if numbers.share > 0.0:
            _follow_flange(calls[_FOLLOW], (side.held, motion.flange, x, motion.earlier_x, rates, work.along))
        _fill_bed(calls[_BED], (*moved, work.along, rates, base, side.bed.target))
        if side.bed.rates != 0:
            resist, begun = record_at(side.bed.rates, StepRates), (x, motion.earlier_x, motion.memory)
            two, span = numbers.two_steps, numbers.span
            _fill_rates(resist.calls[0], (side.film, *begun, two, span, resist))
        _fill_flight(calls[_FLIGHT], (x, velocity, before, numbers.h, numbers.fraction, motion.new_x))
        _place_flight(calls[_PLACE], (side.held, motion.flange, motion.new_x))
        copy(motion.memory, motion.new_memory)
        if work.more.eyelets.shape[0] > 0:
            given = motion.x, side.film.eyelets, motion.memory, tension, work.more.eyelets
            _freeze_losses(work.calls[_FREEZE], given)
            for s in range(work.more.share.shape[0]):
                if side.film.eyelets.places[s] >= 0:
                    work.more.share[s] = work.more.eyelets[s, FROZEN_SHARE]
    copy(motion.new_memory, work.reference)
    copy_rows(motion.new_x, work.served[0])
    for k in range(side.film.parts.shape[0] - 1):
        work.parts[k, :] = 0.0
        work.parts[k, TO_DO], work.parts[k, LEFT] = 1.0, place.reuse_max
        work.parts[k, RESIDUAL] = work.parts[k, ENERGY] = math.inf
        work.parts[k, TRIED] = math.nan
        work.parts[k, SWEEPS] = FOLD_SWEEPS + 1 if steps else 0


@kernel
def film_step(
    at: int, loads: PlainLoads, touching: Touching, motion: StepMotion, place: StepPlace
) -> tuple[bool, int, int, float, float]:
    """Solve, or continue, with the `FilmSide` at an address; see `RecordStore`.

    It returns whether it has converged, iterations, tangents, residual and potential.

    Iterations are those with a kept factorisation in this call, tangents the new ones in the whole solution:
    of several parts the most. The residual [N] is the largest if it has not converged, the potential in J.
    Of a step it fills the bed's target and the end of the motion, of one that has not converged base instead
    of velocities; bed, motion and work say what they hold.
    """
    side = record_at(at, FilmSide)
    work, numbers, count = side.work, side.numbers, side.film.parts.shape[0] - 1
    turn, parts = small_matrix(3, 3), work.parts[:count]
    acting = FilmActing(loads, work.more, touching, side.bed)
    if place.begins != GOES_ON:
        _prepare(side, loads.tension, motion, place)
    served, tangents, residual, energy, done = 0, 0, 0.0, 0.0, True
    for k in range(count):
        if parts[k, TO_DO] != 0.0:
            left = parts[k, LEFT]
            _solve_part(side, acting, motion, turn, place, k)
            served = max(served, int(left - parts[k, LEFT]))
        tangents = max(tangents, int(parts[k, TANGENTS]))
        residual, energy = max(residual, parts[k, RESIDUAL]), energy + parts[k, ENERGY]
        done = done and parts[k, TO_DO] == 0.0
    if done and count > 1:
        ends = motion.new_x, work.gradient, side.kept.free
        residual = _largest_residual(work.calls[_RESIDUAL], ends)
        if not residual < numbers.tolerance:  # what is left of the parts adds up: once more, all of them
            for k in range(count):
                parts[k, TO_DO], parts[k, LEFT], parts[k, ASKS] = 1.0, place.reuse_max, TANGENT
            done = False
    if done and numbers.span > 0.0:
        x, base = motion.new_x, motion.new_velocity
        for i in range(x.shape[0]):
            for r in range(3):
                base[i, r] = (x[i, r] - base[i, r]) / numbers.span
    return done, served, tangents, residual, energy
