"""Many ticks of arm and chain of frames in one kernel, without Python in between.

After the rigid half of a tick the chain takes one implicit step with the flange's new pose and what its film
may touch, and returns the next wrench, and loads on bodies. The film is there where anything is near: its
nodes are combinations of the frames. A soft half is left, as that of a film is, where the lists of what is
near are not valid, or bodies give way otherwise than known; so is a step that does not converge in one go.
Where bodies do not go where the film has met them, it follows them, and solves its step again.
"""

from operator import itemgetter
from typing import Annotated, Final, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import device_function, handing_on_views, kernel, record_at, small_matrix
from cosim.base.numba_insides import caller
from cosim.coupling import half_ticks
from cosim.coupling.contact import contact_kernels
from cosim.coupling.contact.contact_arrays import AHEAD_TICKS, ContactArrays
from cosim.coupling.half_ticks import RigidSide, fill_flange, hand_over, rigid_half
from cosim.coupling.ticks import Servos, Ticks
from cosim.reduced.sections.assembly import combine_points
from cosim.reduced.sections.section_energy import weighted_rows
from cosim.reduced.sections.section_strains import LoadedChain
from cosim.reduced.solve.chain_step import FREE_FLIGHT, ChainEnds, ChainScheme, ChainSide, solve_chain
from cosim.reduced.solve.newton import fill_rows


class ChainCommands(NamedTuple):
    """What the chain is asked for in each of n ticks.

    Args:
        pressure: (n,) [Pa].
        first: (n,), first of the spline's functions that are not zero at that pressure.
        weights: (n, TERMS), their values.
        tension: (n, k) [N], of all cable segments.
    """

    pressure: Vector
    first: Indices
    weights: Matrix
    tension: Matrix

    def some(self, first: int, end: int) -> "ChainCommands":
        """Return what is asked for in some of the ticks."""
        return ChainCommands._make(map(itemgetter(slice(first, end)), self))


class ChainMotion(NamedTuple):
    """How a chain moves in n ticks.

    Args:
        motion: (n + 2, 2, f, 4, 3), from the step before the last one on.
        gradient: (n, f, 6).
    """

    motion: Annotated[NDArray[np.float64], numba.float64[:, :, :, :, ::1]]
    gradient: Blocks

    def from_on(self, first: int) -> "ChainMotion":
        """Return the rows of a tick and all after it."""
        return ChainMotion._make(map(itemgetter(slice(first, None)), self))


class ChainTables(NamedTuple):
    """What changes with the pressure, over its spline.

    Args:
        energies: (size, s c).
        lengths: (size, s).
        eyelets: (size, 6 k).
    """

    energies: Matrix
    lengths: Matrix
    eyelets: Matrix


class ChainFilm(NamedTuple):
    """The film on a chain, and what it may touch in a tick.

    Args:
        contact: address of the `ContactArrays` with the scene.
        rest_m: how far the film looks for shapes at rest.
        pressure: (1,) [Pa], at which its nodes are.
        before: (n,), the first of the two frames that each node is between.
        weights: (n, 2, 4), each as a combination of their points.
        table: (size, 8 n), the same over the spline of pressure.
        x: (2, n, 3) [m], nodes before even ticks of a row, and odd ones.
        velocity: (n, 3) [m/s], before a tick.
        first: (k,), and
        rows: (k, COLUMNS), see `LoadedChain`: room for contacts.
    """

    contact: int
    rest_m: float
    pressure: Vector
    before: Indices
    weights: Blocks
    table: Matrix
    x: Blocks
    velocity: Matrix
    first: Indices
    rows: Matrix


class ChainSteps(NamedTuple):
    """What all ticks in a row have in common.

    Args:
        side: the chain in the first of them.
        tables: over the spline of pressure.
        solve: address of the kernel of a step.
        hand_over: address of that kernel.
        scheme: of the steps.
        film: near what it may touch; with room for no nodes where all is far.
        two_steps: whether steps look back over two.
        earlier: whether the first row of the motion holds the step before the last.
        kept: whether the factor is used for the first of them.
        begun: whether the rigid half of the first has been taken.
    """

    side: ChainSide
    tables: ChainTables
    solve: int
    hand_over: int
    scheme: ChainScheme
    film: ChainFilm
    two_steps: bool
    earlier: bool
    kept: bool
    begun: bool


_hand_over, _solve_chain = caller(hand_over), caller(solve_chain)
_find_touched, _meet_touched = caller(contact_kernels.find_touched), caller(contact_kernels.meet_touched)
_follow_touched = caller(contact_kernels.follow_touched)
_FOLLOWS_MAX: Final = 12  # of bodies in a tick
_NEARER: Final = 0.7  # share of the distance from bodies that a film leaves which continues to follow them


@device_function
def _command(row: ChainSteps, commands: ChainCommands, k: int) -> None:
    """Bring tensions and pressure to those of tick k; the chain is at the pressure of the first."""
    chain, tables, first, weights = row.side.chain, row.tables, commands.first[k], commands.weights[k]
    for i in range(chain.tension.shape[0]):
        chain.tension[i] = commands.tension[k, i]
    if k > 0 and commands.pressure[k] != commands.pressure[k - 1]:
        weighted_rows(tables.energies, first, weights, chain.coefficients.reshape(-1))
        weighted_rows(tables.eyelets, first, weights, chain.eyelets.reshape(-1))
        weighted_rows(tables.lengths, first, weights, chain.inverse_length)
        for s in range(chain.inverse_length.shape[0]):
            chain.inverse_length[s] = 1.0 / chain.inverse_length[s]


@handing_on_views
def _touching(side: ChainSide, film: ChainFilm, widths: Vector, found: int) -> ChainSide:
    """Return the chain with the first contacts."""
    c = side.chain
    chain = LoadedChain(
        c.coefficients, c.inverse_length, c.near, c.rims, c.mass, c.load, c.far, c.eyelets, c.tension,
        film.first[:found], film.rows[:found], widths,
    )  # fmt: skip
    return ChainSide(chain, side.free, side.offsets, side.work)


@device_function
def _find(row: ChainSteps, k: int) -> int:
    """Find what the film may touch in tick k; return how much, -1 where lists do not serve."""
    film, ahead = row.film, AHEAD_TICKS * row.scheme.h
    contact = record_at(film.contact, ContactArrays)
    given = film.contact, film.x[k % 2], film.velocity, film.rest_m, ahead
    return _find_touched(contact.calls[contact_kernels.FIND_TOUCHED], given)


@device_function
def _solve(
    row: ChainSteps, ends: ChainEnds, found: int, again: tuple[bool, bool], done: tuple[Ticks, int]
) -> tuple[bool, bool]:
    """Take the chain's step with what was found; return whether it converged, and whether its factor serves.

    Args:
        row: see `ChainSteps`.
        ends: of the step.
        found: contacts.
        again: whether it looks back over two steps, and whether the factor is used.
        done: ticks, filled, and which of them it is.
    """
    (both, kept), (ticks, k), film = again, done, row.film
    contact = record_at(film.contact, ContactArrays)
    planes = contact_kernels.touched_planes(contact.touched, found).planes
    if not fill_rows(planes, film.before, film.weights, film.first, film.rows):
        return False, kept
    side = _touching(row.side, film, contact.touched.widths, found)
    outcome, spent, ticks.residual[k], kept, _, _ = _solve_chain(
        row.solve, (side, row.scheme, ends, FREE_FLIGHT, both, kept)
    )
    ticks.iterations[k] += spent
    return outcome == 0, kept


@device_function
def _meet(
    row: ChainSteps, ends: ChainEnds, near: tuple[int, int], again: tuple[bool, bool],
    done: tuple[Ticks, int],
) -> tuple[int, bool]:  # fmt: skip
    """Solve a tick's step until bodies go where the film has met them; it is left where they do not soon.

    Args:
        row: see `ChainSteps`.
        ends: of the step.
        near: contacts, and whether bodies are among them that give way.
        again: see `_solve`.
        done: see `_solve`.
    """
    film, k, (both, kept), left = row.film, done[1], again, np.inf
    contact = record_at(film.contact, ContactArrays)
    for follows in range(_FOLLOWS_MAX + 1):
        converged, kept = _solve(row, ends, near[0], (both, kept), done)
        if not converged:
            break
        if film.velocity.shape[0] == 0:
            return half_ticks.ALL_DONE, kept
        combine_points(ends.there[0], film.before, film.weights, film.x[(k + 1) % 2])
        if near[1] == 0:
            return half_ticks.ALL_DONE, kept
        meets = film.contact, film.x[(k + 1) % 2], row.scheme.tolerance_N, row.scheme.h, follows > 0
        before, left = left, _meet_touched(contact.calls[contact_kernels.MEET_TOUCHED], meets)
        if left <= 1.0:
            return half_ticks.ALL_DONE, kept
        if not left < _NEARER * before:
            break
        _follow_touched(contact.calls[contact_kernels.FOLLOW_TOUCHED], (film.contact, film.x[k % 2]))
    return half_ticks.SOFT_HALF_LEFT, kept


@device_function
def _take_soft_half(
    commands: ChainCommands, row: ChainSteps, ends: ChainEnds, again: tuple[bool, bool],
    done: tuple[Ticks, int],
) -> tuple[int, int, bool]:  # fmt: skip
    """Take the soft half of a tick; return how much it might touch, how it ended, and if its factor serves.

    It ended with ALL_DONE, or the tick is left.
    """
    k, film, found, near = done[1], row.film, 0, 0
    if film.velocity.shape[0] > 0:
        found = _find(row, k)
        if found < 0:
            return found, half_ticks.LISTS_LEFT, again[1]
        near = contact_kernels.may_give_way(record_at(film.contact, ContactArrays), found)
        if near > 1:
            return found, half_ticks.SOFT_HALF_LEFT, again[1]
        if commands.pressure[k] != film.pressure[0]:
            film.pressure[0] = commands.pressure[k]
            weighted_rows(film.table, commands.first[k], commands.weights[k], film.weights.reshape(-1))
    ended, kept = _meet(row, ends, (found, near), again, done)
    return found, ended, kept


@kernel
def advance_chain(
    rigid: RigidSide, servos: Servos, commands: ChainCommands, row: ChainSteps, ticks: Ticks, way: ChainMotion
) -> tuple[int, int, bool]:
    """Advance by as many ticks as the servos are asked for, or fewer.

    Returns:
        Ticks done, how it ended, whether the factor is kept.
    """
    flange, kept, film = small_matrix(4, 3), row.kept, row.film
    count = servos.position.shape[0]
    if film.velocity.shape[0] > 0:
        combine_points(way.motion[1, 0], film.before, film.weights, film.x[0])
        combine_points(way.motion[1, 1], film.before, film.weights, film.velocity)
    for k in range(count):
        # by its address it costs 1 % of a tick
        if (k > 0 or not row.begun) and not rigid_half(rigid, servos, ticks, k):
            return k, half_ticks.RIGID_SIDE_WARNS, kept
        _command(row, commands, k)
        fill_flange(ticks, k, flange)
        both = row.two_steps and (row.earlier or k > 0)
        if k == 1 and not row.earlier:  # the factor is of a step that looked back over one only
            kept = kept and not row.two_steps
        ends = ChainEnds(
            way.motion[k + 1], way.motion[k], flange, way.motion[k + 2], way.gradient[k], ticks.figures[k + 1]
        )
        found, ended, kept = _take_soft_half(commands, row, ends, (both, kept), (ticks, k))
        if ended != half_ticks.ALL_DONE:
            return k, ended, kept
        _hand_over(row.hand_over, (rigid.scene.applied, ticks, k))
        if film.velocity.shape[0] > 0:
            combine_points(ends.there[1], film.before, film.weights, film.velocity)
            moved, contact = (film.x[k % 2], film.x[(k + 1) % 2]), record_at(film.contact, ContactArrays)
            if contact_kernels.conclude_touch(contact, film.contact, found, moved, ticks, k):
                return k + 1, half_ticks.ALL_DONE, kept
    return count, half_ticks.ALL_DONE, kept
