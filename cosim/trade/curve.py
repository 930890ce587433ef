"""What a candidate of a trade does, tick by tick, and what that costs.

The speed is simulated time over CPU time of the loop (not wall time, so that other work on the machine does
not count as waiting), with whatever follows the run inside: `cosim run` records.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from itertools import chain
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.scenario import Scenario
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch
from cosim.trade.simulation import Build

_COLUMNS = ("time_s", "tip_position", "flange_force", "contact_force_N", "phase", "newton_iterations")
STRETCH_S = 0.2
"""Simulated time over which a run must not be slower than its bound."""


Follow: TypeAlias = Callable[[Scenario, RunInfo], AbstractContextManager[Callable[[TickBatch], None]]]
"""Opens what follows a run; the context gives what is called with all ticks."""


class TooSlowError(Exception):
    """A run is slower than its bound; it has been ended."""


def unfollowed(_scenario: Scenario, _stage: RunInfo) -> AbstractContextManager[Callable[[TickBatch], None]]:
    """Follow a run with nothing."""
    return nullcontext(lambda _batch: None)


@final
@dataclass(frozen=True)
class Curve:
    """What a candidate did.

    Args:
        time_s: (k,).
        tip: (k, 3) [m].
        objects: (k, m, 3) [m], those that can move.
        force: (k, 3) [N], of the soft robot on the flange.
        contact: (k,) [N], sum of the normal forces of all contacts.
        phase_ends: (phases,) indices of the last snapshot of each phase.
        cpu_s: of the loop.
        iterations: Newton iterations a tick.
    """

    time_s: Array
    tip: Array
    objects: Array
    force: Array
    contact: Array
    phase_ends: tuple[int, ...]
    cpu_s: float
    iterations: float

    def at(self, times: Array) -> Curve:
        """Return the curve at given times (n,), linear in between; without phase ends."""
        rows = [
            np.stack(
                [np.interp(times, self.time_s, column) for column in values.reshape(len(values), -1).T], 1
            )
            if values.size
            else np.zeros((len(times), 0))
            for values in (self.tip, self.objects, self.force, self.contact)
        ]
        objects = rows[1].reshape(len(times), -1, 3)
        return Curve(times, rows[0], objects, rows[2], rows[3][:, 0], (), self.cpu_s, self.iterations)

    def mean_force(self, begin_s: Array, end_s: Array) -> Array:
        """Return the mean of the flange force over windows of time, of all ticks in them.

        The force is linear between ticks, so a window need not begin or end with one.

        Args:
            begin_s: (n,), within the run.
            end_s: (n,), within the run, later than the beginnings.

        Returns:
            (n, 3) [N], axes as of `force`.
        """
        times = np.unique(np.concatenate([self.time_s, begin_s, end_s]))
        force = np.stack([np.interp(times, self.time_s, column) for column in self.force.T], 1)
        each = 0.5 * (force[1:] + force[:-1]) * np.diff(times)[:, None]
        impulse = np.concatenate([np.zeros((1, 3)), np.cumsum(each, axis=0)])
        gained = impulse[np.searchsorted(times, end_s)] - impulse[np.searchsorted(times, begin_s)]
        return np.asarray(gained / (end_s - begin_s)[:, None])

    @property
    def real_time_factor(self) -> float:
        """Simulated time over CPU time."""
        return float(self.time_s[-1]) / self.cpu_s if self.cpu_s > 0.0 else float("nan")


@final
@dataclass
class CurveBuilder:
    """Collects a curve from ticks.

    Args:
        scenario: that is run.
        stage: of the run.
    """

    scenario: Scenario
    stage: RunInfo
    _arrays: dict[str, list[Array]] = field(default_factory=lambda: {name: [] for name in _COLUMNS})
    _objects: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        can_move = {entry.name for entry in self.scenario.objects if entry.mass_kg is not None}
        self._bodies = [k for k, name in enumerate(self.stage.body_names) if name in can_move]

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        self._objects.append(batch.body_position[:, self._bodies])
        for name, found in self._arrays.items():
            found.append(getattr(batch, name))

    def curve(self, cpu_s: float) -> Curve:
        """Return what was collected, which took so much CPU time."""
        objects = np.concatenate(self._objects)
        time_s, tip, force, contact, phase, iterations = map(np.concatenate, self._arrays.values())
        last = len(phase) - 1
        ends = [k for k in range(1, last + 1) if k == last or phase[k + 1] != phase[k]]
        each = int(iterations[1:].sum()) / max(1, last)
        return Curve(time_s, tip, objects, force, contact, tuple(ends), cpu_s, each)


def trace(
    scenario: Scenario,
    build: Build,
    follow: Follow = unfollowed,
    *,
    slowest: float = 0.0,
    advance: Callable[[float], None] = lambda _share: None,
) -> Curve:
    """Run a scenario and keep its curves.

    Args:
        scenario: checked.
        build: makes its simulation.
        follow: what else sees all ticks, inside the measured time.
        slowest: real-time factor that every stretch of at least 0.2 s must reach; 0 for no bound.
        advance: told after every stretch how much of the run is done, from 0 to 1.

    Raises:
        CosimError: it cannot be built or solved.
        TooSlowError: a stretch is slower than the bound.
    """
    simulation = build(scenario)
    batches, stage = simulation.batches(), simulation.stage
    first = next(batches)  # before the clock starts: this one finds the start equilibrium
    builder = CurveBuilder(scenario, stage)
    bound = 1.0 / slowest if slowest > 0.0 else float("inf")
    stretch_from_s = 0.0
    with follow(scenario, stage) as observe:
        began = stretch_began = time.process_time()
        for batch in chain([first], batches):
            builder.observe(batch)
            observe(batch)
            now, time_s = time.process_time(), float(batch.time_s[-1])
            stretch_s = time_s - stretch_from_s
            if now - stretch_began > bound * max(stretch_s, STRETCH_S):
                where = f"{time_s:.2f} s, in '{stage.phase_names[batch.phase[-1]]}'"
                raise TooSlowError(f"slower than x{slowest:g} real time at {where}")
            if stretch_s >= STRETCH_S:
                advance(batch.tick[-1] / stage.ticks)
                stretch_from_s, stretch_began = time_s, now
    spent = time.process_time() - began  # with what the follower had still to write
    return builder.curve(spent)
