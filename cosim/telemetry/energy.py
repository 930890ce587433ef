"""Energy balance of a lumped soft robot in time, from what a run shows of its ticks.

Work is summed over ticks by the trapezoidal rule, with forces at both ends: of the gas p dV, of cables T dL
at their base ends, of the flange by its wrench. These and the weight put energy in. Elastic energy is that of
all elements, at rest in the shape of a phase's end.

What the integrator takes is found apart from all these, from motion alone. The masses' accelerations a_n of
its formulas say what all forces together have done: sum m (a_n + a_n+1) (x_n+1 - x_n) / 2. An exact
integrator turns that into kinetic energy; what is missing there is lost. So the rest of the balance is no
such loss: it is the work of contacts, and where nothing is touched the error of the balance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Final, NamedTuple, Protocol, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import Blocks, IndexTable, Matrix, Vector, kernel
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.state import StepOptions

KINETIC, DONE, RELATIVE, MOVING, COLUMNS = range(5)
WORKS: Final = ("gas_J", "cables_J", "flange_J", "gravity_J", "eyelets_J", "damping_J", "air_drag_J")


class _Pace(NamedTuple):
    """Of steps: whether they look back over two, their length [s], how many were taken before."""

    two_steps: bool
    h: float
    taken: int


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
        motion: (5, n, 3), positions one and two ticks before, velocities the same, accelerations one before.
        out: (k, COLUMNS), filled: kinetic energy [J], work that all forces have done in the tick [J], sums of
            mass times the square of velocities relative to the flange, and of velocities [W s].
    """
    for t in range(x.shape[0]):
        both = pace.two_steps and pace.taken + t > 0
        span = 2.0 * pace.h / 3.0 if both else pace.h
        kinetic = done = relative = moving = 0.0
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
                kinetic += 0.5 * mass[i] * v * v
                done += 0.5 * mass[i] * (a + motion[4, i, r]) * (x[t, i, r] - motion[0, i, r])
                relative += mass[i] * (v - u) * (v - u)
                moving += mass[i] * v * v
                motion[1, i, r], motion[0, i, r] = motion[0, i, r], x[t, i, r]
                motion[3, i, r], motion[2, i, r], motion[4, i, r] = motion[2, i, r], v, a
        out[t, 0], out[t, 1], out[t, 2], out[t, 3] = kinetic, done, relative, moving


@kernel
def fill_lengths(x: Blocks, segments: IndexTable, out: Matrix) -> None:
    """Fill the lengths (k, s) [m] of segments (s, 2) of cables in k shapes (k, n, 3) [m]."""
    for t in range(x.shape[0]):
        for s in range(segments.shape[0]):
            square = 0.0
            for r in range(3):
                along = x[t, segments[s, 1], r] - x[t, segments[s, 0], r]
                square += along * along
            out[t, s] = np.sqrt(square)


class SeenTicks(Protocol):
    """What the balance sees of ticks: columns of a `TickBatch`."""

    @property
    def node_position(self) -> Array:
        """See `TickBatch`."""

    @property
    def chamber_volume_m3(self) -> Array:
        """See `TickBatch`."""

    @property
    def chamber_pressure_Pa(self) -> Array:
        """See `TickBatch`."""

    @property
    def cable_tension_N(self) -> Array:
        """See `TickBatch`."""

    @property
    def wrench(self) -> Array:
        """See `TickBatch`."""

    @property
    def flange_position(self) -> Array:
        """See `TickBatch`."""

    @property
    def flange_rotation(self) -> Array:
        """See `TickBatch`."""

    @property
    def flange_twist(self) -> Array:
        """See `TickBatch`."""


@final
@dataclass(frozen=True)
class EnergyParts:
    """What the balance knows of the body.

    Args:
        mass: (n,) [kg].
        segments: (s, 2), nodes of all cables' segments.
        cable: (s,), of which each is.
        ratio: positions (n, 3) [m] -> tension of each segment over that at its base end (s,).
        elastic: positions (n, 3) [m] -> elastic energy [J].
        options: of the steps.
        tick_s: their length.
        gravity: (3,) [m/s^2].
        known_losses: whether `ratio` is all that eyelets lose by.
    """

    mass: Array
    segments: IntArray
    cable: IntArray
    ratio: Callable[[Array], Array]
    elastic: Callable[[Array], float]
    options: StepOptions
    tick_s: float
    gravity: Array
    known_losses: bool

    @classmethod
    def of(cls, body: SoftBody, options: StepOptions, tick_s: float, gravity: Array) -> EnergyParts:
        """Return them for a body and its steps."""
        cables = body.cables
        segments = [np.asarray(cable.segments) for cable in cables]
        return cls(
            body.node_mass,
            np.concatenate([np.zeros((0, 2), np.int64), *segments]),
            np.repeat(np.arange(len(cables)), [len(own) for own in segments]),
            partial(_ratios, body),
            partial(_elastic, body, []),
            options,
            tick_s,
            gravity,
            not any(cable.remembers for cable in cables),
        )

    def begin(self) -> EnergyFigures:
        """Return the balance before the first tick."""
        return EnergyFigures()


def _ratios(body: SoftBody, positions: Array) -> Array:
    return np.concatenate([np.zeros(0), *(cable.tension_ratio(positions) for cable in body.cables)])


def _elastic(body: SoftBody, made: list[SoftSystem], positions: Array) -> float:
    if not made:
        made.append(SoftSystem(body))
    system, x = made[0], np.array(positions, order="C")
    loads, memory = Loads((), (0.0,) * len(body.cables), (0.0, 0.0, 0.0)), system.fresh(body.first_memory())
    return system.evaluate(x, loads, system.segment_share(x, loads), memory, hessian=False)


@final
@dataclass(frozen=True)
class EnergyRow:
    """What the next tick is compared with.

    Args:
        motion: see `fill_motion`.
        sums: (COLUMNS,).
        volume: (chambers,) [m^3].
        pressure: (chambers,) [Pa].
        tension: (cables,) [N].
        length: (s,) [m].
        wrench: (6,).
        origin: (3,) [m].
        rotation: (3, 3).
    """

    motion: Annotated[Array, (5, "nodes", 3)]
    sums: Annotated[Array, (4,)]
    volume: Annotated[Array, ("chambers",)]
    pressure: Annotated[Array, ("chambers",)]
    tension: Annotated[Array, ("*",)]
    length: Annotated[Array, ("*",)]
    wrench: Annotated[Array, (6,)]
    origin: Annotated[Array, (3,)]
    rotation: Annotated[Array, (3, 3)]


@final
@dataclass(frozen=True)
class EnergyFigures:
    """The balance of the ticks so far.

    Args:
        works: [J], in the order of `WORKS`.
        done: work of all forces [J], by the masses' accelerations.
        elastic: elastic energy at the start [J].
        ticks: seen.
        last: of them; None before the first.
    """

    works: tuple[float, ...] = (0.0,) * len(WORKS)
    done: float = 0.0
    elastic: float = 0.0
    ticks: int = 0
    last: EnergyRow | None = None

    def after(self, batch: SeenTicks, parts: EnergyParts) -> EnergyFigures:
        """Return the balance with some ticks more; the state before the first one is by itself."""
        x = np.ascontiguousarray(batch.node_position)
        length = np.empty((len(x), len(parts.segments)))
        fill_lengths(x, parts.segments, length)
        columns = (
            batch.chamber_volume_m3, batch.chamber_pressure_Pa, batch.cable_tension_N, length, batch.wrench,
            batch.flange_position, batch.flange_rotation,
        )  # fmt: skip
        if self.last is None:
            motion, sums = np.zeros((5, *x.shape[1:])), np.zeros(COLUMNS)
            motion[:2] = x[0]
            row = EnergyRow(motion, sums, *(column[0].copy() for column in columns))
            return replace(self, elastic=parts.elastic(x[0]), last=row)
        last, options = self.last, parts.options
        motion, sums = last.motion.copy(), np.zeros((len(x) + 1, COLUMNS))
        sums[0] = last.sums
        pace = _Pace(options.integrator == "bdf2", parts.tick_s, self.ticks)
        fill_motion(
            x, parts.mass, np.ascontiguousarray(batch.flange_twist),
            np.ascontiguousarray(batch.flange_position), pace, motion, sums[1:],
        )  # fmt: skip
        before = (
            last.volume,
            last.pressure,
            last.tension,
            last.length,
            last.wrench,
            last.origin,
            last.rotation,
        )
        volume, pressure, tension, length, wrench, origin, rotation = (
            np.concatenate([one[None], column]) for one, column in zip(before, columns, strict=True)
        )
        lost = 1.0 - parts.ratio(x[-1]) if parts.known_losses else np.zeros(len(parts.cable))
        turned = np.einsum("kab,kcb->kac", rotation[1:], rotation[:-1])
        skew = 0.5 * (turned - turned.swapaxes(1, 2))  # a turn within a tick is small
        turn = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        way = np.hstack([np.diff(origin, axis=0), turn])
        shorter, pulls = -np.diff(length, axis=0), _mean(tension)[:, parts.cable]
        rates = parts.tick_s * _mean(sums).sum(axis=0)
        found = (
            (_mean(pressure) * np.diff(volume, axis=0)).sum(),
            (pulls * shorter).sum(),
            -(_mean(wrench) * way).sum(),
            float(parts.mass @ (x[-1] - last.motion[0]) @ parts.gravity),
            (pulls * shorter @ lost).sum(),
            options.damping_per_s * rates[RELATIVE],
            options.air_drag_per_s * rates[MOVING],
        )
        works = tuple(float(own + np.sum(more)) for own, more in zip(self.works, found, strict=True))
        row = EnergyRow(motion, sums[-1].copy(), *(column[-1].copy() for column in columns))
        return EnergyFigures(
            works, self.done + float(sums[1:, DONE].sum()), self.elastic, self.ticks + len(x), row
        )

    def figures(self, parts: EnergyParts) -> dict[str, float | None]:
        """Return the balance since the start for the summary."""
        if self.last is None:
            return {}
        works = dict(zip(WORKS, self.works, strict=True))
        kinetic, elastic = float(self.last.sums[KINETIC]), parts.elastic(self.last.motion[0]) - self.elastic
        numerical = self.done - kinetic
        put_in = works["gas_J"] + works["cables_J"] + works["flange_J"] + works["gravity_J"]
        losses = works["eyelets_J"] + works["damping_J"] + works["air_drag_J"]
        rest = put_in - losses - elastic - kinetic - numerical
        found: dict[str, Any] = works | {
            "elastic_J": elastic, "kinetic_J": kinetic, "numerical_J": numerical, "rest_J": rest,
        }  # fmt: skip
        return found if parts.known_losses else found | {"eyelets_J": None}


def _mean(rows: Array) -> Array:
    """Return the means of rows that follow one another."""
    return np.asarray(0.5 * (rows[1:] + rows[:-1]))
