"""A simulation that follows a moving robot by readings of its joints, pressures and tensions; a reading of
time t advances the simulation to t, by whole ticks.
"""

import math
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Final, Protocol, Self, final

import numpy as np

from cosim.devices.command_checks import row_of_numbers
from cosim.devices.controller import Command
from cosim.devices.live.streams import Reading, Stream, Streams, open_stream
from cosim.errors import InputError
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

APPROACH_s: Final = 2.0
"""Simulated time in which the simulation moves evenly to the robot's first reading, before it follows."""
GAP_s: Final = 0.5
"""Time in which the simulation moves evenly across a longer gap of the robot's clock, or a step back."""
LATENCIES: Final = 100_000
"""Largest number of latencies that are kept: a twin may follow for days."""
_FIRST_s: Final = 10.0
_ROUNDING: Final = 1e-6


class Followed(Protocol):
    """A simulation that is stepped by commands, such as `Simulation`."""

    @property
    def stage(self) -> RunInfo:
        """Everything that does not change."""

    @property
    def snapshot(self) -> Snapshot:
        """The present state."""

    def step(self, command: Command | None = None, /, *, ticks: int = 1) -> Snapshot:
        """Advance by some ticks."""


@final
@dataclass(frozen=True)
class Prediction:
    """The simulation at the instant of a reading.

    Args:
        time_s: of the reading, on the robot's clock.
        snapshot: of the simulation: tip, sag, the wrench on the flange.
        latency_s: from the arrival of the reading to this prediction.
    """

    time_s: float
    snapshot: Snapshot
    latency_s: float


@final
class Twin:
    """Follows a robot; iterating yields a `Prediction` for every reading, until all streams have ended.

    The simulation first moves to the robot's state, then follows every reading. If it is slower than the
    robot, its latency grows: use a faster model or longer ticks.

    Args:
        simulation: a `Simulation`, of a scenario without phases (`{"phase": []}`) so that it does not end.
        streams: texts for `open_stream`, or streams; at least one has times.

    Raises:
        InputError: a stream cannot be opened, or none has a time within 10 s.
    """

    def __init__(self, simulation: Followed, streams: Sequence[str | Stream]) -> None:
        self.simulation = simulation
        self.followed = self.gaps = 0
        """Readings with a time, and jumps of that time."""
        self._notes: Counter[str] = Counter()
        self._lowest_N: dict[str, float] = {}
        self._newest = Reading()
        self.latencies_s: deque[float] = deque(maxlen=LATENCIES)
        """Of the last `LATENCIES` predictions since the simulation caught up with the robot."""
        self._caught_up = False
        self._tick_s = self.simulation.stage.tick_s
        self._command = Command()
        self._streams = Streams(self._tick_s)
        try:
            for stream in streams:
                self._streams.add(open_stream(stream) if isinstance(stream, str) else stream)
            self._clock_s = self._approach()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Prediction]:
        """Yield a prediction for every reading with a time.

        Raises:
            InputError: a reading cannot be parsed, or has a value that is not allowed.
            SolverError: the physics could not be solved.
        """
        while (reading := self._streams.next()) is not None:
            self._update(reading)
            if reading.time_s is None or not math.isfinite(reading.time_s):
                continue
            self._follow(reading.time_s)
            latency_s = time.perf_counter() - reading.arrived_s
            if self._caught_up:
                self.latencies_s.append(latency_s)
            self._caught_up |= not self._streams.waiting
            yield Prediction(reading.time_s, self.simulation.snapshot, latency_s)

    def close(self) -> None:
        """Close the streams."""
        self._streams.close()

    def __repr__(self) -> str:
        """Return one line: number of readings, latency, and readings that could not be followed."""
        line = f"{self.followed} readings followed, {self.gaps} gaps"
        if self.latencies_s:
            shown = 1e3 * np.percentile(self.latencies_s, [50.0, 99.0, 100.0])
            line += "; latency {:.1f} ms, in 99 % at most {:.1f} ms, largest {:.1f} ms".format(*shown)
        notes = [f"{text} ({count} times)" for text, count in self.notes.items()]
        notes += [f"lowest {cable}: {low_N:.3g} N" for cable, low_N in self._lowest_N.items()]
        return "; ".join([line, *notes])

    @property
    def notes(self) -> Mapping[str, int]:
        """Readings that were left out or changed, in words, with their number."""
        return self._streams.left_out + self._notes

    def _update(self, reading: Reading) -> None:
        """Update the next command by a reading; values of a newer reading stay."""
        if reading.time_s is not None and not math.isfinite(reading.time_s):
            self._notes["left out: readings whose time_s is not finite"] += 1
            return
        reading = self._usable(reading)
        self._add(reading)
        if reading.time_s is not None:
            newest_s = self._newest.time_s
            if newest_s is not None and 0.0 < newest_s - reading.time_s < self._tick_s:
                self._add(self._newest)
            else:
                self._newest = reading

    def _add(self, reading: Reading) -> None:
        joints = self._command.joint_position if reading.joint_position is None else reading.joint_position
        self._command = Command(
            joint_position=joints,
            pressure_Pa={**self._command.pressure_Pa, **reading.pressure_Pa},
            cable_tension_N={**self._command.cable_tension_N, **reading.cable_tension_N},
        )

    def _usable(self, reading: Reading) -> Reading:
        """Return a reading without values that are not finite, and with tensions of at least 0.

        Raises:
            InputError: joints are beyond the arm's bounds.
        """
        joints, arm = reading.joint_position, self.simulation.stage.arm
        if joints is not None and arm is not None:
            count = len(arm.limits.joint_names)
            values = np.array(row_of_numbers(joints, count, "a reading: joint_position"))
            if not np.isfinite(values).all():
                self._notes["left out: joint_position that is not finite"] += 1
                joints = None
            else:
                arm.limits.check_measured(values, "a reading: joint_position")
        pressures = self._finite(reading.pressure_Pa, "pressure_Pa")
        tensions = dict(self._finite(reading.cable_tension_N, "cable_tension_N"))
        for cable, tension in tensions.items():
            if isinstance(tension, int | float) and tension < 0.0:
                self._notes[f"set to 0: cable_tension_N of '{cable}' below 0"] += 1
                self._lowest_N[cable] = min(tension, self._lowest_N.get(cable, 0.0))
                tensions[cable] = 0.0
        return replace(reading, joint_position=joints, pressure_Pa=pressures, cable_tension_N=tensions)

    def _finite(self, values: Mapping[str, float], key: str) -> Mapping[str, float]:
        """Return values by name without those that are not finite."""
        lost = [
            name for name, value in values.items() if isinstance(value, float) and not math.isfinite(value)
        ]
        for name in lost:
            self._notes[f"left out: {key} of '{name}' that is not finite"] += 1
        return {name: value for name, value in values.items() if name not in lost} if lost else values

    def _approach(self) -> float:
        """Move to the robot's state, and return its time."""
        until = time.perf_counter() + _FIRST_s
        time_s = None
        while time_s is None:
            reading = self._streams.next(within_s=max(until - time.perf_counter(), 0.0))
            if reading is None:
                raise InputError(f"no stream has sent a time_s within {_FIRST_s:g} s; one must")
            self._update(reading)
            time_s = self._newest.time_s
        self._move(APPROACH_s)
        return time_s

    def _follow(self, time_s: float) -> None:
        """Advance to the last whole tick up to a time of the robot."""
        self.followed += 1
        ahead = (time_s - self._clock_s) / self._tick_s + _ROUNDING
        if not (ahead > -1.0 and ahead * self._tick_s <= GAP_s):
            self.gaps += 1
            self._clock_s = time_s
            self._move(GAP_s)
        elif ticks := max(int(ahead), 0):
            self._clock_s += ticks * self._tick_s
            self._step(ticks)

    def _move(self, within_s: float) -> None:
        self._step(max(round(within_s / self._tick_s), 1))

    def _step(self, ticks: int) -> None:
        """Step with the present command, and note whether the joints are too slow for it."""
        reached, arm = self.simulation.step(self._command, ticks=ticks), self.simulation.stage.arm
        if arm is None or self._command.joint_position is None:
            return
        # the target of a tick is that of its start
        target = np.clip(self._command.joint_position, arm.limits.lower, arm.limits.upper)
        if arm.limits.too_fast(target - reached.joint_target, self._tick_s).any():
            self._notes["joints behind: readings faster than the arm's bounds of speed"] += 1
