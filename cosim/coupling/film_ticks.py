"""Many ticks of arm and film in one kernel, without Python in between.

After the rigid half of a tick the film takes one step with the flange's new pose (`film_step`) and what it
may touch, and returns the next wrench, and loads on bodies. The soft half of a tick is left in which the
lists of what is near are not valid, the flange turns far, or bodies are pressed of which it is not known how
they give way (`giving_way`); its soft step in the middle where a tangent is indefinite, and once it is solved
where bodies do not go where it has met them. A row ends after a tick with which bodies are to be weighed.
"""

import math
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import address_of, device_function, kernel, record_at, small_matrix, small_vector
from cosim.base.numba_insides import caller
from cosim.coupling import half_ticks
from cosim.coupling.contact import contact_kernels
from cosim.coupling.contact.contact_arrays import AHEAD_TICKS, ContactArrays
from cosim.coupling.contact.contact_kernels import FASTEST, FIND_TOUCHED, MEET_TOUCHED, meet_touched
from cosim.coupling.half_ticks import RigidSide, fill_flange, hand_over, take_rigid_half
from cosim.coupling.ticks import Servos, Ticks
from cosim.reduced.sections.assembly import CENTER, fill_center_and_inertia
from cosim.soft.body.loads import PlainLoads, Touching
from cosim.soft.contact.self_contact_pairs import pair_work, settle_pairs
from cosim.soft.elements.eyelets import eyelet_loss
from cosim.soft.elements.mass_terms import mass_moments
from cosim.soft.film.step_arrays import StepMotion, StepPlace
from cosim.soft.solve import self_contact
from cosim.soft.solve.film_step import FilmSide, film_step
from cosim.soft.solve.self_contact import ADD, FIND, OVERLOOKED, PRESS, SETTLE, THROUGH_M, WORK, FilmContacts
from cosim.soft.solve.state import Damped, add_damping, add_wrench


class FilmCommands(NamedTuple):
    """What the film is asked for in each of n ticks.

    Args:
        pressure: (n, chambers) [Pa].
        tension: (n, cables) [N], at their base ends.
        gravity: (n, 3) [m/s^2].
    """

    pressure: Matrix
    tension: Matrix
    gravity: Matrix

    def some(self, first: int, end: int) -> "FilmCommands":
        """Return what is asked for in some of the ticks."""
        return FilmCommands._make(map(itemgetter(slice(first, end)), self))


class FilmMotion(NamedTuple):
    """How a film moves in n ticks.

    Args:
        x: (n + 2, nodes, 3) [m], from the step before the last one on.
        velocity: (n + 2, nodes, 3) [m/s], the same.
        memory: (n + 1, values), what its elements remember.
    """

    x: Blocks
    velocity: Blocks
    memory: Matrix

    def from_on(self, first: int) -> "FilmMotion":
        """Return the rows of a tick and all after it."""
        return FilmMotion._make(map(itemgetter(slice(first, None)), self))


class FilmSteps(NamedTuple):
    """What all ticks in a row have in common.

    Args:
        side: address of the `FilmSide` of the soft steps, see `RecordStore`.
        place: from which they begin where nothing is touched.
        touching_place: the same where something is.
        rest_m: how far the film looks for shapes at rest.
        films_rest_m: the same for its own films.
        ahead_s: the time for whose way of the fastest node it looks further.
        calls: (kernels,), see `film_calls`.
        mass: (nodes, 1, 1) [kg].
        largest_turn: [rad], of the flange in a tick; beyond it a step is left.
        contact: address of the `ContactArrays` with the scene.
        films: address of the `FilmContacts` of films that may touch one another.
        fast: speed [m/s] of what is touched from which on a row ends.
        whole: whether parts that nothing couples are solved together until films let go, where a row ends.
    """

    side: int
    place: StepPlace
    touching_place: StepPlace
    rest_m: float
    films_rest_m: float
    ahead_s: float
    calls: Indices
    mass: Blocks
    largest_turn: float
    contact: int
    films: int
    fast: float
    whole: bool


_CALLED = (film_step, add_wrench, mass_moments, take_rigid_half, hand_over, add_damping, eyelet_loss)
_STEP, _WRENCH, _MOMENTS, _RIGID, _HAND, _DAMPING, _LOSS = range(len(_CALLED))
_film_step, _add_wrench, _mass_moments, _take_rigid_half, _hand_over, _add_damping, _eyelet_loss = map(
    caller, _CALLED
)
_find_touched, _meet_touched = caller(contact_kernels.find_touched), caller(meet_touched)
_fastest_touched = caller(contact_kernels.fastest_touched)
_find_pairs, _settle_pairs, _films_press = (
    caller(self_contact.find_pairs),
    caller(settle_pairs),
    caller(self_contact.films_press),
)
_pair_work = caller(pair_work)


def film_calls(rigid_half: Any) -> IntArray:
    """Return the places (7,) of the kernels that a row of ticks calls.

    Args:
        rigid_half: kernel that takes rigid halves, see `take_rigid_half`; None where they have been taken.
    """
    calls = np.array([address_of(called) for called in _CALLED])
    calls[_RIGID] = 0 if rigid_half is None else address_of(rigid_half)
    return calls


@device_function
def _take_soft_step(
    found: tuple[int, int],
    commands: FilmCommands,
    row: FilmSteps,
    ticks: Any,
    way: FilmMotion,
    k: int,
    flange: Matrix,
) -> bool:
    """Take the film's step of tick k with planes and pairs that were found; return whether it converged."""
    contact, films = record_at(row.contact, ContactArrays), record_at(row.films, FilmContacts)
    planes, pairs = (
        contact_kernels.touched_planes(contact.touched, found[0]),
        self_contact.first_pairs(films.pairs, found[1]),
    )
    touching = Touching(planes, films.calls[ADD] if found[1] > 0 else 0, pairs)
    loads = PlainLoads(commands.pressure[k], commands.tension[k], commands.gravity[k])
    motion = StepMotion(
        way.x[k + 1], way.velocity[k + 1], way.x[k], way.velocity[k], way.memory[k], flange,
        way.x[k + 2], way.velocity[k + 2], way.memory[k + 1],
    )  # fmt: skip
    place = row.place if found[0] + found[1] == 0 else row.touching_place
    given = row.side, loads, touching, motion, place
    converged, iterations, tangents, residual, _ = _film_step(row.calls[_STEP], given)
    ticks.residual[k], ticks.iterations[k] = residual, iterations + (tangents if converged else 0)
    return converged


@device_function
def _find_overlooked(row: FilmSteps, way: FilmMotion, k: int) -> int:
    """Return with how many pairs of films tick k is taken again, -1 for lists with too little room."""
    films, end = record_at(row.films, FilmContacts), (way.x[k + 2], way.velocity[k + 2])
    pressing = _films_press(films.calls[PRESS], (row.films, *end, row.ahead_s, THROUGH_M))
    if pressing <= 0:
        return pressing
    films.counts[OVERLOOKED] = 1
    begin = way.x[k + 1], way.velocity[k + 1]
    pairs = _find_pairs(films.calls[FIND], (row.films, *begin, row.films_rest_m, row.ahead_s))
    if pairs == 0:
        films.counts[OVERLOOKED] = 0
    return pairs


@device_function
def _find(row: FilmSteps, motion: tuple[Matrix, Matrix], waits: bool) -> tuple[int, int]:
    """Find planes and pairs of films that may be touched; return how many, -1 where lists do not serve.

    `motion` are positions and velocities before the step.
    """
    contact, films = record_at(row.contact, ContactArrays), record_at(row.films, FilmContacts)
    planes, pairs = 0, 0
    if contact.calls.shape[0] > 0:
        planes = _find_touched(contact.calls[FIND_TOUCHED], (row.contact, *motion, row.rest_m, row.ahead_s))
    if films.calls.shape[0] > 0 and planes >= 0 and not waits:
        pairs = _find_pairs(films.calls[FIND], (row.films, *motion, row.films_rest_m, row.ahead_s))
    return planes, pairs


@device_function
def _settle(row: FilmSteps, found: tuple[int, int], way: FilmMotion, ticks: Any, k: int) -> bool:
    """Take in the end of a step that might touch, or has let go of something; return if it is asked for."""
    contact, films = record_at(row.contact, ContactArrays), record_at(row.films, FilmContacts)
    before, x = way.x[k + 1], way.x[k + 2]
    if films.calls.shape[0] > 0:
        rows, memory, deepest = self_contact.first_pairs(films.pairs, found[1]), films.memory, 0.0
        if found[1] > 0:
            given = films.calls[ADD], before, x, rows, films.force
            ticks.work[k, 1] = _pair_work(films.calls[WORK], given)
        count = _settle_pairs(films.calls[SETTLE], (x, rows, films.key[: found[1]], False, memory))
        films.counts[self_contact.REMEMBERED] = ticks.self_contact[k, 0] = count
        for e in range(count):
            ticks.self_contact[k, 1] += memory.normal_force[e]
            deepest = memory.distance[e] if e == 0 else min(deepest, memory.distance[e])
        ticks.self_contact[k, 2] = -deepest
    return contact_kernels.conclude_touch(contact, row.contact, found[0], (before, x), ticks, k)


@device_function
def _turns_far(ticks: Any, k: int, most: float) -> bool:
    """Return whether the flange has turned by more than an angle [rad] in tick k."""
    trace = 0.0
    for r in range(3):
        for c in range(3):
            trace += ticks.axes[k, r, c] * ticks.axes[k + 1, r, c]
    return math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0)))) > most


@device_function
def _solve(
    commands: FilmCommands, row: FilmSteps, done: tuple[Any, FilmMotion], k: int, flange: Matrix
) -> tuple[tuple[int, int], int]:
    """Solve the soft half of tick k; return planes and pairs, and how it ended, -1 for a tick to conclude."""
    ticks, way = done
    side, contact = record_at(row.side, FilmSide), record_at(row.contact, ContactArrays)
    films = record_at(row.films, FilmContacts)
    waits = films.waits and films.counts[self_contact.REMEMBERED] == 0  # first without contact of films
    found = _find(row, (way.x[k + 1], way.velocity[k + 1]), waits)
    if min(found) < 0:
        return found, half_ticks.LISTS_LEFT
    near = contact_kernels.may_give_way(contact, found[0])
    if near > 1 or _turns_far(ticks, k, row.largest_turn):
        return found, half_ticks.SOFT_HALF_LEFT
    again = True
    while again:  # of the step one place alone: it is compiled for each
        if not _take_soft_step(found, commands, row, ticks, way, k, flange):
            return found, half_ticks.SOFT_STEP_BEGUN
        again = False
        if waits:
            waits, pairs = False, _find_overlooked(row, way, k)
            found, again = (found[0], pairs), pairs > 0
            if pairs < 0 or (again and side.film.parts.shape[0] > 2):  # pairs couple parts
                left = half_ticks.SOFT_HALF_LEFT if films.counts[OVERLOOKED] else half_ticks.SOFT_STEP_SOLVED
                return found, left
    meets = row.contact, way.x[k + 2], side.numbers.tolerance, row.ahead_s / AHEAD_TICKS, False
    if near and not _meet_touched(contact.calls[MEET_TOUCHED], meets) <= 1.0:
        return found, half_ticks.SOFT_STEP_SOLVED
    if films.waits:
        films.counts[OVERLOOKED] = 0
    return found, -1


@device_function
def _fill_figures(
    row: FilmSteps, done: tuple[Any, FilmMotion], k: int, flange: Matrix, moments: Vector
) -> None:
    """Fill the film's wrench on the flange, its mass, and what its cables have lost in tick k."""
    ticks, way = done
    side, calls = record_at(row.side, FilmSide), row.calls
    x, figures, share = way.x[k + 2], ticks.figures[k + 1], side.numbers.share
    for r in range(CENTER):
        figures[r] = 0.0
    _add_wrench(calls[_WRENCH], (side.held, side.work.gradient, x, flange, figures[:CENTER]))
    if share > 0.0:
        damped = Damped(side.film.mass, share, side.numbers.span, side.work.along)
        _add_damping(calls[_DAMPING], (damped, x, way.velocity[k + 2], flange, figures[:CENTER]))
    total = _mass_moments(calls[_MOMENTS], (row.mass, x.reshape((x.shape[0], 1, 3)), moments))
    fill_center_and_inertia(total, moments, flange[0], figures)
    ticks.work[k, 2] = 0.0
    if side.work.more.eyelets.shape[0] > 0:
        given = x, side.film.eyelets, way.memory[k], way.memory[k + 1]
        ticks.work[k, 2] = _eyelet_loss(calls[_LOSS], given)


@device_function
def _take_tick(
    asked: tuple[Any, Any, FilmCommands], row: FilmSteps, done: tuple[Any, FilmMotion], k: int,
    scratch: tuple[Matrix, Vector],
) -> int:  # fmt: skip
    """Take tick k; return how it ended, -1 if the next one may follow.

    Args:
        asked: rigid side, its servos, and what the film is asked for.
        row: see `FilmSteps`.
        done: ticks and motion, filled.
        k: the tick.
        scratch: (4, 3) and (9,).
    """
    (rigid, servos, commands), (ticks, way), (flange, moments) = asked, done, scratch
    if row.calls[_RIGID] != 0 and not _take_rigid_half(row.calls[_RIGID], (rigid, servos, ticks, k)):
        return half_ticks.RIGID_SIDE_WARNS
    fill_flange(ticks, k, flange)
    found, ended = _solve(commands, row, done, k, flange)
    if ended >= 0:
        return ended
    _fill_figures(row, done, k, flange, moments)
    _hand_over(row.calls[_HAND], (rigid.scene.applied, ticks, k))
    if _settle(row, found, way, ticks, k):
        return half_ticks.ALL_DONE
    if found[0] > 0 and row.fast < np.inf:
        moving = row.contact, way.x[k + 2], way.velocity[k + 2]
        if _fastest_touched(record_at(row.contact, ContactArrays).calls[FASTEST], moving) > row.fast:
            return half_ticks.ALL_DONE
    if row.whole and record_at(row.films, FilmContacts).counts[self_contact.REMEMBERED] == 0:
        return half_ticks.ALL_DONE
    return -1


@kernel
def advance_film(
    rigid: RigidSide, servos: Servos, commands: FilmCommands, row: FilmSteps, ticks: Ticks, way: FilmMotion
) -> tuple[int, int]:
    """Advance by as many ticks as the servos are asked for, or fewer; return (ticks done, how it ended)."""
    flange, moments = small_matrix(4, 3), small_vector(9)
    count = servos.position.shape[0]
    for k in range(count):
        ended = _take_tick((rigid, servos, commands), row, (ticks, way), k, (flange, moments))
        if ended >= 0:
            return k + (ended == half_ticks.ALL_DONE), ended
    return count, half_ticks.ALL_DONE
