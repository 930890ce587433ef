"""Energy balance of a lumped soft robot in time, from what a run shows of its ticks.

Work is summed over ticks by the trapezoidal rule, with forces at both ends: of the gas p dV, of cables T dL
at their base ends, of the flange by its wrench. These and the weight put energy in. Elastic energy is that of
all elements, at rest in the shape of a phase's end.

Bodies that touch the film put in what contact takes from them, by its force over their mean velocities. What
the film gets of that is the work on its nodes; the difference is lost in contact: to friction, and as film
and bodies take their steps one after the other. While contacts press, it holds their elastic energy as well.

What the integrator takes is found apart from all these, from motion alone. The masses' accelerations a_n of
its formulas say what all forces together have done: sum m (a_n + a_n+1) (x_n+1 - x_n) / 2. An exact
integrator turns that into kinetic energy; what is missing there is lost. So the rest of the balance is no
such loss: it is the error of the balance.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias, final

import numpy as np

from cosim.base.columns import TickTable
from cosim.base.frames import Array, IntArray, Shown
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel
from cosim.base.names import TERMS, WORKS
from cosim.coupling.shape_figures import SubstepRecord
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.state import StepOptions
from cosim.telemetry.energy_figures import KINETIC, EnergyFigures, EnergyRow, balance

Pieces: TypeAlias = Mapping[int, SubstepRecord]
"""Of ticks that were taken in pieces, by row."""
DONE, DAMPED, DRAGGED, FALLING, RESISTED, COLUMNS = range(KINETIC + 1, KINETIC + 7)
_ELASTIC_S: Final = 0.1
"""Simulated time between those: the energy of the film costs a fifth of a tick."""


class _Pace(NamedTuple):
    """Of steps: whether they look back over two, their length [s], how many were taken before; gravity."""

    two_steps: bool
    h: float
    taken: int
    gravity: Vector


@kernel
def fill_motion(
    x: Blocks, mass: Vector, twist: Matrix, origin: Matrix, pace: _Pace, motion: Blocks, out: Matrix
) -> None:
    """Fill the sums of k ticks, and bring what is known of the motion to the end of the last.

    Args:
        x: (k, n, 3) [m].
        mass: (n,) [kg].
        twist: (k, 6), of the flange, linear and angular, world axes.
        origin: (k, 3) [m], of the flange.
        pace: of the ticks.
        motion: (6, n, 3), positions one and two ticks before, velocities the same, accelerations and
            velocities of points that move along with the flange one before.
        out: (k, COLUMNS), filled but for the last: kinetic energy [J], work that all forces have done in the
            tick [J], work against the velocities relative to the flange, and against the velocities, as
            forces of 1 N s/m for each kilogram do it [J s], work of the weight in the tick [J], power lost in
            materials [W].
    """
    for t in range(x.shape[0]):
        both = pace.two_steps and pace.taken + t > 0
        span = 2.0 * pace.h / 3.0 if both else pace.h
        kinetic = done = damped = dragged = falling = 0.0
        for i in range(x.shape[1]):
            for r in range(3):
                j, k = (r + 1) % 3, (r + 2) % 3
                base, speed = motion[0, i, r], motion[2, i, r]
                if both:
                    base = (4.0 * base - motion[1, i, r]) / 3.0
                    speed = (4.0 * speed - motion[3, i, r]) / 3.0
                v = (x[t, i, r] - base) / span
                a = (v - speed) / span
                u = twist[t, r] + twist[t, 3 + j] * (x[t, i, k] - origin[t, k])
                u -= twist[t, 3 + k] * (x[t, i, j] - origin[t, j])
                went, along = x[t, i, r] - motion[0, i, r], motion[5, i, r]
                kinetic += 0.5 * mass[i] * v * v
                done += 0.5 * mass[i] * (a + motion[4, i, r]) * went
                # by the mean of both ends, as all other forces: in a hit velocities jump from tick to tick
                mean = 0.5 * (v + motion[2, i, r])
                damped += mass[i] * (mean - 0.5 * (u + along)) * (went - 0.5 * pace.h * (u + along))
                dragged += mass[i] * mean * went
                falling += mass[i] * pace.gravity[r] * went
                motion[1, i, r], motion[0, i, r] = motion[0, i, r], x[t, i, r]
                motion[3, i, r], motion[2, i, r], motion[4, i, r] = motion[2, i, r], v, a
                motion[5, i, r] = u
        out[t, 0], out[t, 1], out[t, 2], out[t, 3], out[t, 4] = kinetic, done, damped, dragged, falling


class _Routes(NamedTuple):
    """Of cables: nodes of their segments, of which each is, the share of tension that it has not got after
    each tick, and its length [m] before it."""

    segments: IndexTable
    cable: Indices
    lost: Matrix
    length: Vector


@device_function
def _pull(x: Matrix, routes: Any, lost_share: Vector, tension: Vector) -> tuple[float, float, float]:
    """Return the work of cables in a tick, what of it eyelets lose, and what those make that it slides back.

    Lengths are brought to the tick's end.
    """
    put_in, lost, made, length, slid = 0.0, 0.0, 0.0, routes.length, 0.0
    for s in range(length.shape[0] - 1, -1, -1):
        square = 0.0
        for r in range(3):
            along = x[routes.segments[s, 1], r] - x[routes.segments[s, 0], r]
            square += along * along
        now = np.sqrt(square)
        work = tension[routes.cable[s]] * (length[s] - now)
        put_in, lost, length[s] = put_in + work, lost + lost_share[s] * work, now
        slid += work  # by the tension, of all that is beyond the eyelet where the segment begins
        first = s == 0 or routes.cable[s - 1] != routes.cable[s]
        made -= min(0.0, (lost_share[s] - (0.0 if first else lost_share[s - 1])) * slid)
        slid = 0.0 if first else slid
    return put_in, lost, made


@device_function
def _carry(wrench: Vector, pose: Vector, before: Vector) -> float:
    """Return the work of the flange in a tick, by poses of a place and nine axes; a turn is small."""
    work = 0.0
    for r in range(3):
        j, k, turn = 3 * ((r + 1) % 3), 3 * ((r + 2) % 3), 0.0
        for c in range(3, 6):
            turn += 0.5 * (pose[k + c] * before[j + c] - pose[j + c] * before[k + c])
        work -= wrench[r] * (pose[r] - before[r]) + wrench[3 + r] * turn
    return work


@kernel
def fill_works(x: Blocks, routes: _Routes, rows: Matrix, mean: Matrix, chambers: int, out: Matrix) -> None:
    """Fill the works [J] of gas, cables and flange, and what is lost at eyelets, in each tick.

    Args:
        x: (k, n, 3) [m].
        routes: of the cables; lengths are brought to the end.
        rows: (k + 1, columns), see `EnergyRow`, the first from before the ticks.
        mean: (k, columns), of rows that follow one another.
        chambers: how many.
        out: (k, works), the first four and the last filled.
    """
    pose = rows.shape[1] - 12
    for t in range(x.shape[0]):
        now, before, between, gas = rows[t + 1], rows[t], mean[t], 0.0
        for c in range(chambers):
            gas += between[chambers + c] * (now[c] - before[c])
        cables, lost, made = _pull(x[t], routes, routes.lost[t], between[2 * chambers : pose - 6])
        out[t, 0], out[t, 1], out[t, 3], out[t, out.shape[1] - 1] = gas, cables, lost, made
        out[t, 2] = _carry(between[pose - 6 : pose], now[pose:], before[pose:])


@final
@dataclass(frozen=True)
class EnergyParts(Shown):
    """What the balance knows of the body.

    Args:
        mass: (n,) [kg].
        segments: (s, 2), nodes of all cables' segments.
        cable: (s,), of which each is.
        lost: positions (n, 3) [m] -> share (s,) of the tension at its base end that each segment has not got,
            where that does not depend on how the cable slides.
        elastic: positions (n, 3) [m] -> elastic energy [J].
        resisted: positions (3, n, 3) [m] two ticks before a tick's end, one before, and there, and whether
            its step looks back over both -> power lost in materials [W]; None where none has losses.
        options: of the steps.
        tick_s: their length.
        gravity: (3,) [m/s^2].
    """

    mass: Array
    segments: IntArray
    cable: IntArray
    lost: Callable[[Array], Array]
    elastic: Callable[[Array], float]
    resisted: Callable[[Array, bool], float] | None
    options: StepOptions
    tick_s: float
    gravity: Array

    @classmethod
    def of(
        cls,
        body: SoftBody,
        elastic: Callable[[Array], float],
        resisted: Callable[[Array, bool], float] | None,
        options: StepOptions,
        tick_s: float,
        gravity: Array,
    ) -> "EnergyParts":
        """Return them for a body and its steps."""
        cables = body.cables
        segments = [np.asarray(cable.segments) for cable in cables]
        return cls(
            body.node_mass,
            np.concatenate([np.zeros((0, 2), np.int64), *segments]),
            np.repeat(np.arange(len(cables)), [len(own) for own in segments]),
            _lost(body),
            elastic,
            resisted,
            options,
            tick_s,
            gravity,
        )

    def begin(self) -> EnergyFigures:
        """Return the balance before the first tick."""
        return EnergyFigures()

    def after(self, before: EnergyFigures, batch: TickTable, pieces: Pieces) -> tuple[EnergyFigures, Array]:
        """Return the balance with some ticks more, and its terms at each of them, see `balance_after`."""
        return balance_after(before, batch, pieces, self)


def _lost(body: SoftBody) -> Callable[[Array], Array]:
    if any(cable.friction_coefficient > 0.0 and not cable.remembers for cable in body.cables):
        return partial(_lost_at, body)
    return partial(_always, _lost_at(body, body.positions))  # the same at every shape


def _lost_at(body: SoftBody, positions: Array) -> Array:
    ratios = (
        np.ones(len(cable.segments)) if cable.remembers else cable.tension_ratio(positions)
        for cable in body.cables
    )
    return np.asarray(1.0 - np.concatenate([np.zeros(0), *ratios]))


def _always(share: Array, _positions: Array) -> Array:
    return share


def balance_after(
    before: EnergyFigures, batch: TickTable, pieces: Pieces, parts: EnergyParts
) -> tuple[EnergyFigures, Array]:
    """Return the balance with some ticks more, and its `TERMS` at each of them (k, terms) [J].

    The state before the first tick is by itself. Ticks are summed in order: however many come at once,
    every bit of the balance is the same. Elastic energy and rest are not numbers but every 0.1 s.
    """
    x, volume = np.require(batch.node_position, None, ["C", "W"]), batch.chamber_volume_m3
    columns = (
        volume, batch.chamber_pressure_Pa, batch.cable_tension_N, batch.wrench, batch.flange_position,
        batch.flange_rotation.reshape(-1, 9),
    )  # fmt: skip
    seen = np.concatenate(columns, axis=1)
    length = np.zeros(len(parts.segments)) if before.last is None else before.last.length.copy()
    rows = np.concatenate([seen[:1] if before.last is None else before.last.seen[None], seen])
    lost = np.array([parts.lost(shape) for shape in x])
    routes = _Routes(parts.segments.copy(), parts.cable.copy(), lost, length)
    each = np.zeros((len(x), len(WORKS)))
    fill_works(x, routes, rows, _mean(rows), volume.shape[1], each)
    if before.last is None:
        motion = np.zeros((6, *x.shape[1:]))
        motion[:2] = x[0]
        row = EnergyRow(motion, np.zeros(COLUMNS), length, rows[-1].copy())
        return replace(before, elastic=parts.elastic(x[0]), last=row), np.zeros((1, len(TERMS)))
    motion, sums = before.last.motion.copy(), np.zeros((len(x) + 1, COLUMNS))
    sums[0], options = before.last.sums, parts.options
    if parts.resisted is not None:
        known = np.concatenate([motion[1::-1], x])
        both = options.integrator == "bdf2"
        for t in range(len(x)):
            sums[t + 1, RESISTED] = parts.resisted(known[t : t + 3], both and before.ticks + t > 0)
    begun = _moved(before, batch, pieces, parts, motion, sums[1:])
    each[:, WORKS.index("eyelets_J")] += batch.eyelets_J
    each[:, WORKS.index("gravity_J") : WORKS.index("eyelets_made_J")] = np.stack(
        [
            sums[1:, FALLING],
            batch.contact_work_J,
            batch.self_contact_work_J,
            options.damping_per_s * sums[1:, DAMPED],
            options.air_drag_per_s * sums[1:, DRAGGED],
            parts.tick_s * _mean(sums)[:, RESISTED],
            -batch.bodies_work_J,
            -batch.bodies_work_J - batch.contact_work_J,
        ],
        axis=1,
    )
    row = EnergyRow(motion, sums[-1].copy(), length, rows[-1].copy(), begun)
    works = np.cumsum(np.vstack([before.works, each]), axis=0)[1:]
    done = np.cumsum([before.done, *sums[1:, DONE]])[1:]
    after = EnergyFigures(
        tuple(works[-1].tolist()), float(done[-1]), before.elastic, before.ticks + len(x), row
    )
    return after, balance(works, _elastic(before, x, parts), sums[1:, KINETIC], done)


def _moved(
    before: EnergyFigures, batch: TickTable, pieces: Pieces, parts: EnergyParts, motion: Array, sums: Array
) -> Array | None:
    """Fill the sums of ticks, and bring the motion to their end, as `fill_motion` does; return `begun`.

    The first piece after a whole tick looks back over no step, the first whole tick over the last one.
    """
    begun = None if before.last is None else before.last.begun
    both, at = parts.options.integrator == "bdf2", 0
    # kernels take what can be written to
    shown = batch.node_position, batch.flange_twist, batch.flange_position
    x, twist, origin = (np.require(each, None, ["C", "W"]) for each in shown)
    mass, gravity = parts.mass.copy(), parts.gravity.copy()
    for end in [*sorted(pieces), len(x)]:
        if at < end:
            if begun is not None:
                motion[1], motion[3] = begun
            begun, pace = None, _Pace(both, parts.tick_s, before.ticks + at, gravity)
            fill_motion(x[at:end], mass, twist[at:end], origin[at:end], pace, motion, sums[at:end])
        if end < len(x):
            known = pieces[end]
            shown = known.positions, known.twist, known.origin
            places, twists, origins = (np.require(each, None, ["C", "W"]) for each in shown)
            pace = _Pace(both, parts.tick_s / len(places), int(begun is not None), gravity)
            begun, found = motion[[0, 2]], np.zeros((len(places), COLUMNS))
            fill_motion(places, mass, twists, origins, pace, motion, found)
            sums[end, :RESISTED] = found[:, :RESISTED].sum(axis=0)
            sums[end, KINETIC] = found[-1, KINETIC]
        at = end + 1
    return begun


def _elastic(before: EnergyFigures, x: Array, parts: EnergyParts) -> Array:
    """Return the elastic energy since the start (k,) [J] in the next ticks at x (k, n, 3) [m]."""
    every = max(1, round(_ELASTIC_S / parts.tick_s))
    found = np.full(len(x), np.nan)
    for row in range(every - 1 - before.ticks % every, len(x), every):
        found[row] = parts.elastic(x[row]) - before.elastic
    return found


def _mean(rows: Array) -> Array:
    """Return the means of rows that follow one another."""
    return np.asarray(0.5 * (rows[1:] + rows[:-1]))
