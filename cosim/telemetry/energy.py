"""Energy balance of a lumped soft robot in time. Works are summed over ticks by the trapezoidal rule, with
forces at both ends: p dV of the gas, T dL of cables at their base ends, that of the flange by its wrench;
these and the weight put energy in. Elastic energy is that of all elements, at rest in the shape of a phase's
end. Touching bodies put in the work of their contact forces over their mean velocities; the film receives the
work on its nodes, and the difference is lost in contact, to friction and as film and bodies step one after
the other. Contacts also hold elastic energy while they press. The integrator's loss follows from motion
alone: its accelerations a_n give the work of all forces, sum m (a_n + a_n+1) (x_n+1 - x_n) / 2, which an
exact integrator turns into kinetic energy; the missing part is lost. The rest of the balance is therefore its
error.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, TypeAlias, final

import numpy as np

from cosim.base.columns import TickTable
from cosim.base.frames import Array, IntArray, Shown
from cosim.base.names import TERMS, WORKS
from cosim.coupling.shape_figures import SubstepRecord
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.step_scheme import StepOptions
from cosim.telemetry.energy_figures import KINETIC, EnergyFigures, EnergyRow, balance
from cosim.telemetry.energy_kernels import (
    COLUMNS,
    DAMPED,
    DONE,
    DRAGGED,
    FALLING,
    RESISTED,
    Pace,
    Routes,
    fill_motion,
    fill_works,
)

Substeps: TypeAlias = Mapping[int, SubstepRecord]
"""Substeps of the ticks that were taken in several, by row."""
_ELASTIC_S: Final = 0.1
"""Simulated time between two elastic energies: each takes a fifth of a tick."""


@final
@dataclass(frozen=True)
class EnergyParts(Shown):
    """The body and its steps, for the energy balance.

    Args:
        mass: (n,) [kg].
        segments: (s, 2), nodes of all cables' segments.
        cable: (s,), index of each segment's cable.
        lost: positions (n, 3) [m] -> tension (s,) lost in each segment, over that at the base end, as far as
            it does not depend on the sliding of the cable.
        elastic: positions (n, 3) [m] -> elastic energy [J].
        resisted: positions (3, n, 3) [m] two ticks before a tick's end, one before, and at its end, and
            whether its step uses both -> power lost in materials [W]; None without losses.
        options: of the steps.
        tick_s: length of a tick.
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
        """Return the parts of a body and its steps."""
        cables = body.cables
        segments = [np.asarray(cable.segments) for cable in cables]
        return cls(
            body.node_mass,
            np.concatenate([np.zeros((0, 2), np.int64), *segments]),
            np.repeat(np.arange(len(cables)), [len(each) for each in segments]),
            _lost(body),
            elastic,
            resisted,
            options,
            tick_s,
            gravity,
        )

    def after(
        self, before: EnergyFigures, batch: TickTable, substeps: Substeps
    ) -> tuple[EnergyFigures, Array]:
        """Return the balance after further ticks, and its `TERMS` at each of them (k, terms) [J].

        The first batch is the state before the first tick alone. Ticks are summed in order, so the result
        does not depend on batches. Elastic energy and rest are computed every 0.1 s, and NaN in other ticks.
        """
        x, volume = np.require(batch.node_position, None, ["C", "W"]), batch.chamber_volume_m3
        columns = (
            volume, batch.chamber_pressure_Pa, batch.cable_tension_N, batch.wrench, batch.flange_position,
            batch.flange_rotation.reshape(-1, 9),
        )  # fmt: skip
        values = np.concatenate(columns, axis=1)
        length = np.zeros(len(self.segments)) if before.last is None else before.last.length.copy()
        rows = np.concatenate([values[:1] if before.last is None else before.last.seen[None], values])
        lost = np.array([self.lost(shape) for shape in x])
        routes = Routes(self.segments.copy(), self.cable.copy(), lost, length)
        each = np.zeros((len(x), len(WORKS)))
        fill_works(x, routes, rows, _mean(rows), volume.shape[1], each)
        if before.last is None:
            motion = np.zeros((6, *x.shape[1:]))
            motion[:2] = x[0]
            row = EnergyRow(motion, np.zeros(COLUMNS), length, rows[-1].copy())
            return replace(before, elastic=self.elastic(x[0]), last=row), np.zeros((1, len(TERMS)))
        motion, sums = before.last.motion.copy(), np.zeros((len(x) + 1, COLUMNS))
        sums[0], options = before.last.sums, self.options
        if self.resisted is not None:
            known = np.concatenate([motion[1::-1], x])
            both = options.integrator == "bdf2"
            for t in range(len(x)):
                sums[t + 1, RESISTED] = self.resisted(known[t : t + 3], both and before.ticks + t > 0)
        begun = _moved(before, batch, substeps, self, motion, sums[1:])
        each[:, WORKS.index("eyelets_J")] += batch.eyelets_J
        each[:, WORKS.index("gravity_J") : WORKS.index("eyelets_made_J")] = np.stack(
            [
                sums[1:, FALLING],
                batch.contact_work_J,
                batch.self_contact_work_J,
                options.damping_per_s * sums[1:, DAMPED],
                options.air_drag_per_s * sums[1:, DRAGGED],
                self.tick_s * _mean(sums)[:, RESISTED],
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
        return after, balance(works, _elastic(before, x, self), sums[1:, KINETIC], done)


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


def _always(ratio: Array, _positions: Array) -> Array:
    return ratio


def _moved(
    before: EnergyFigures,
    batch: TickTable,
    substeps: Substeps,
    parts: EnergyParts,
    motion: Array,
    sums: Array,
) -> Array | None:
    """Fill the sums of ticks, and update the motion, as `fill_motion` does; return `begun`.

    The first substep after a whole tick does not use the step before, the first whole tick uses the last one.
    """
    begun = None if before.last is None else before.last.begun
    both, at = parts.options.integrator == "bdf2", 0
    columns = batch.node_position, batch.flange_twist, batch.flange_position
    x, twist, origin = (
        np.require(each, None, ["C", "W"]) for each in columns
    )  # kernels need writable arrays
    mass, gravity = parts.mass.copy(), parts.gravity.copy()
    for end in [*sorted(substeps), len(x)]:
        if at < end:
            if begun is not None:
                motion[1], motion[3] = begun
            begun, pace = None, Pace(both, parts.tick_s, before.ticks + at, gravity)
            fill_motion(x[at:end], mass, twist[at:end], origin[at:end], pace, motion, sums[at:end])
        if end < len(x):
            steps = substeps[end]
            columns = steps.positions, steps.twist, steps.origin
            positions, twists, origins = (np.require(each, None, ["C", "W"]) for each in columns)
            pace = Pace(both, parts.tick_s / len(positions), int(begun is not None), gravity)
            begun, each_sum = motion[[0, 2]], np.zeros((len(positions), COLUMNS))
            fill_motion(positions, mass, twists, origins, pace, motion, each_sum)
            sums[end, :RESISTED] = each_sum[:, :RESISTED].sum(axis=0)
            sums[end, KINETIC] = each_sum[-1, KINETIC]
        at = end + 1
    return begun


def _elastic(before: EnergyFigures, x: Array, parts: EnergyParts) -> Array:
    """Return the elastic energy since the start (k,) [J] in the next ticks at x (k, n, 3) [m]."""
    every = max(1, round(_ELASTIC_S / parts.tick_s))
    elastic = np.full(len(x), np.nan)
    for row in range(every - 1 - before.ticks % every, len(x), every):
        elastic[row] = parts.elastic(x[row]) - before.elastic
    return elastic


def _mean(rows: Array) -> Array:
    """Return the means of successive rows."""
    return np.asarray(0.5 * (rows[1:] + rows[:-1]))
