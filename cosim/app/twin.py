"""A simulation that follows a robot while it moves: joints, pressures and tensions come from the robot.

The robot's clock paces it: a reading of time t takes the simulation to t, by whole ticks.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Final, Protocol, Self, final

import numpy as np

from cosim.devices.controller import Command
from cosim.devices.live.streams import Reading, Stream, Streams, open_stream
from cosim.errors import InputError
from cosim.telemetry.snapshot import RunInfo, Snapshot

APPROACH_s: Final = 2.0
"""Simulated time in which the simulation goes evenly to where the robot is, before it follows."""
GAP_s: Final = 0.5
"""Of the robot's clock: across a longer one, or back, the simulation moves evenly within this time."""
_FIRST_s: Final = 10.0
_ROUNDING: Final = 1e-6


class Followed(Protocol):
    """What steps by commands, such as `Simulation`."""

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
        snapshot: of the simulation: tip, sag, the wrench on the flange in its `ledger`.
        latency_s: from the arrival of the reading until this was there.
    """

    time_s: float
    snapshot: Snapshot
    latency_s: float


@final
class Twin:
    """Follows a robot; iterating yields a `Prediction` for every reading, until all streams have ended.

    The simulation first goes to where the robot is, then follows every reading. Where it is slower than the
    robot, its latency grows: take a faster model or longer ticks.

    Args:
        simulation: a `Simulation`, of a scenario without phases (`{"phase": []}`) so that it does not end.
        streams: texts as `open_stream` takes them, or streams; one of them has times.

    Raises:
        InputError: a stream cannot be opened, or none has a time within 10 s.
    """

    def __init__(self, simulation: Followed, streams: Sequence[str | Stream]) -> None:
        self.simulation = simulation
        self.followed = self.gaps = 0
        """Readings with a time, and jumps of that time."""
        self.latencies_s: list[float] = []
        """Of all predictions since the simulation had caught up with the robot."""
        self._caught_up = False
        self._tick_s = self.simulation.stage.tick_s
        self._asked = Command()
        self._streams = Streams()
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
        """Yield what is predicted for every reading with a time.

        Raises:
            InputError: a reading asks for what cannot be, or cannot be understood.
            SolverError: the physics could not be solved.
        """
        while (reading := self._streams.next()) is not None:
            self._take_up(reading)
            if reading.time_s is None:
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
        """Return one line: how many readings it has followed, and how fast."""
        line = f"{self.followed} readings followed, {self.gaps} gaps"
        if self.latencies_s:
            shown = 1e3 * np.percentile(self.latencies_s, [50.0, 99.0, 100.0])
            line += "; latency {:.1f} ms, in 99 % at most {:.1f} ms, largest {:.1f} ms".format(*shown)
        return line

    def _take_up(self, reading: Reading) -> None:
        """Add what a reading says to what is commanded next."""
        joints = self._asked.joint_position if reading.joint_position is None else reading.joint_position
        self._asked = Command(
            joint_position=joints,
            pressure_Pa={**self._asked.pressure_Pa, **reading.pressure_Pa},
            cable_tension_N={**self._asked.cable_tension_N, **reading.cable_tension_N},
        )

    def _approach(self) -> float:
        """Go to where the robot is, and return its time."""
        until = time.perf_counter() + _FIRST_s
        time_s = None
        while time_s is None:
            reading = self._streams.next(within_s=max(until - time.perf_counter(), 0.0))
            if reading is None:
                raise InputError(f"no stream has sent a time_s within {_FIRST_s:g} s; one must")
            self._take_up(reading)
            time_s = reading.time_s
        self._move(APPROACH_s)
        return time_s

    def _follow(self, time_s: float) -> None:
        """Advance to the last whole tick up to a time of the robot."""
        self.followed += 1
        ahead = (time_s - self._clock_s) / self._tick_s + _ROUNDING
        if not 0.0 <= ahead * self._tick_s <= GAP_s:
            self.gaps += 1
            self._clock_s = time_s
            self._move(GAP_s)
        elif ticks := int(ahead):
            self._clock_s += ticks * self._tick_s
            self.simulation.step(self._asked, ticks=ticks)

    def _move(self, within_s: float) -> None:
        self.simulation.step(self._asked, ticks=max(round(within_s / self._tick_s), 1))
