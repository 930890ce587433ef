"""Sensors: readings of a run with noise, bias, delay, rate and quantisation, and measurements through them.

A sensor samples the truth x every 1 / rate_Hz, at the first tick from then on:
    y = q round((x + b + s n_k) / q),    n_k standard normal, new for every sample k.
A sample is held until the next, and seen delay_s later. Before that much time has passed, the first sample is
seen. n_k depends on the seeds, the sensor's name and k alone, so a run that is saved or repeated reads the
same.
"""

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.columns import RunColumns
from cosim.base.frames import Array, Wrench, read_only
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.sensors import SensorTable
from cosim.devices import controller, device_report
from cosim.errors import InputError, ScenarioError

_FIELDS: Final = {
    "pressure": ("pressure_Pa", RunColumns.chamber_pressure_Pa),
    "cable_length": ("cable_length_m", RunColumns.cable_length_m),
    "cable_tension": ("cable_tension_N", RunColumns.cable_tension_N),
    "flange_force": ("flange_wrench", RunColumns.flange_force),
    "flange_torque": ("flange_wrench", RunColumns.flange_torque),
    "tip_position": ("tip_position", RunColumns.tip_position),
    "tip_direction": ("tip_direction", RunColumns.tip_direction),
    "bending_angle": ("bending_angle_rad", RunColumns.bending_angle_rad),
    "joint_position": ("joint_position", RunColumns.joint_position),
    "joint_torque": ("joint_torque", RunColumns.joint_torque),
}
"""By the kind of a sensor: the field of a measurement that it reads, and the column that is its truth."""
_ROUNDING: Final = 1e-6  # of a sample's instant, in samples


def sensor_names(scenario: Scenario, joints: tuple[str, ...]) -> tuple[device_report.SensorNames, ...]:
    """Return the names, units and values of a scenario's sensors, for plots and results.

    Args:
        scenario: checked.
        joints: names of the arm's joints.
    """
    named = zip(scenario.sensors, _values(scenario), strict=True)
    return tuple(
        device_report.SensorNames(entry.name, _FIELDS[entry.kind][1].unit, joints if names is None else names)
        for entry, names in named
    )


def _values(scenario: Scenario) -> list[tuple[str, ...] | None]:
    """Return the names of each sensor's values; None for a sensor of the arm's joints."""
    robot = scenario.soft_robot
    return [entry.values(robot.chamber_names(), robot.cable_names()) for entry in scenario.sensors]


def sensor_report(scenario: Scenario) -> str:
    """Return text on the sensors of a scenario; empty without any."""
    return "; ".join(
        f"{entry.name}, {entry.kind}, noise {_text(entry.noise)}, bias {_text(entry.bias)}, "
        f"{1e3 * entry.delay_s:g} ms late, "
        + ("every tick" if entry.rate_Hz is None else f"{entry.rate_Hz:g} Hz")
        for entry in scenario.sensors
    )


def _text(value: float | Sequence[float]) -> str:
    return f"{value:g}" if isinstance(value, float | int) else ", ".join(f"{one:g}" for one in value)


@final
@dataclass(frozen=True)
class SensorState:
    """State of a sensor.

    Args:
        ticks: since its start.
        sample: (n,), the last one.
        waiting: (delay, n), delayed samples, a row for each tick, the oldest first.
        reading: (n,), the present reading.
    """

    ticks: int
    sample: Annotated[Array, ("n",)]
    waiting: Annotated[Array, ("d", "n")]
    reading: Annotated[Array, ("n",)]


@final
@dataclass(frozen=True)
class SensorsState:
    """State of all sensors.

    Args:
        seed: of the run, in addition to those of the sensors.
        sensors: state of each; none before the first tick.
    """

    seed: int = 0
    sensors: tuple[SensorState, ...] = ()


@final
class Sensor:
    """One sensor.

    Args:
        table: of the scenario.
        tick_s: length of a tick.
        places: indices of its values in the field of a measurement, None for all.
    """

    def __init__(self, table: SensorTable, tick_s: float, places: Sequence[int] | None) -> None:
        self.name, self.kind = table.name, table.kind
        self.delay_ticks = round(table.delay_s / tick_s)
        self._table = table
        self._places = slice(None) if places is None else np.array(places, dtype=int)
        self._samples_per_tick = 1.0 if table.rate_Hz is None else table.rate_Hz * tick_s
        self._named = zlib.crc32(table.name.encode())
        self._noise, self._bias, self._quantum = map(np.array, (table.noise, table.bias, table.quantum))

    def truth(self, seen: controller.Measurement) -> Array:
        """Return the true values (n,)."""
        return self._all(seen)[self._places]

    def through(self, seen: controller.Measurement, reading: Array) -> controller.Measurement:
        """Return a measurement with a reading (n,) in place of the true values."""
        values, (field, _) = self._all(seen), _FIELDS[self.kind]
        values[self._places] = reading
        given: Any = getattr(seen, field)
        made: Any = values
        if isinstance(given, Wrench):
            made = replace(given, **{self.kind.removeprefix("flange_"): values})
        elif isinstance(given, Mapping):
            made = dict(zip(given, values.tolist(), strict=True))
        elif isinstance(given, tuple):
            made = tuple(values.tolist())
        elif isinstance(given, float):
            made = float(values[0])
        return replace(seen, **{field: made})

    def begin(self, truth: Array, seed: int) -> SensorState:
        """Return the state at the start; the first sample counts as older than the delay.

        Raises:
            ScenarioError: noise, bias or quantum have another number of entries than there are values.
        """
        for key in ("noise", "bias", "quantum"):
            given = getattr(self._table, key)
            if isinstance(given, tuple) and len(given) != len(truth):
                problem = f"has {len(given)} entries; the sensor reads {len(truth)} values"
                raise ScenarioError(f"sensor.{self.name}.{key}", problem)
        sample = self._sample(truth, 0, seed)
        return SensorState(0, sample, np.tile(sample, (self.delay_ticks, 1)), sample)

    def next(self, state: SensorState, truth: Array, seed: int) -> SensorState:
        """Return the state one tick later.

        Args:
            state: at the start of the tick.
            truth: (n,) at the end of the tick.
            seed: of the run.
        """
        ticks, sample = state.ticks + 1, state.sample
        count = self._samples(ticks)
        if count > self._samples(state.ticks):
            sample = self._sample(truth, count, seed)
        if not self.delay_ticks:
            return SensorState(ticks, sample, state.waiting, sample)
        return SensorState(ticks, sample, np.vstack([state.waiting[1:], sample]), state.waiting[0])

    def _samples(self, ticks: int) -> int:
        return math.floor(ticks * self._samples_per_tick + _ROUNDING)

    def _sample(self, truth: Array, count: int, seed: int) -> Array:
        found = truth + self._bias
        if self._noise.any():
            key = [self._table.seed + (seed << 32), self._named]
            stream = np.random.Generator(np.random.Philox(key=key, counter=[0, count, 0, 0]))
            found = found + self._noise * stream.standard_normal(len(truth))
        if self._quantum.any():
            step = np.where(self._quantum > 0.0, self._quantum, 1.0)
            found = np.where(self._quantum > 0.0, step * np.round(found / step), found)
        return np.asarray(found)

    def _all(self, seen: controller.Measurement) -> Array:
        value: Any = getattr(seen, _FIELDS[self.kind][0])
        if isinstance(value, Wrench):
            value = getattr(value, self.kind.removeprefix("flange_"))
        return np.array([*value.values()] if isinstance(value, Mapping) else value, dtype=float, ndmin=1)


@final
class Sensors:
    """The sensors of a run; they are read after every tick.

    Args:
        scenario: checked.
        joints: number of the arm's joints.
    """

    def __init__(self, scenario: Scenario, joints: int) -> None:
        robot, tick_s = scenario.soft_robot, scenario.clock.tick_s
        names = robot.chamber_names(), robot.cable_names()
        places = ([entry.named(*names).index(name) for name in entry.of] for entry in scenario.sensors)
        pairs = zip(scenario.sensors, places, strict=True)
        self._sensors = [Sensor(entry, tick_s, read or None) for entry, read in pairs]
        self._sizes = [joints if values is None else len(values) for values in _values(scenario)]
        self._state = SensorsState()

    def __bool__(self) -> bool:
        """Return whether the run has sensors."""
        return bool(self._sensors)

    def begin(self, seen: controller.Measurement, seed: int) -> tuple[Array, Array]:
        """Restart all sensors, and return their readings and true values, see `tick`.

        Args:
            seen: present measurement, exact.
            seed: of the run, in addition to those of the sensors.
        """
        truths = [sensor.truth(seen) for sensor in self._sensors]
        begun = (sensor.begin(truth, seed) for sensor, truth in zip(self._sensors, truths, strict=True))
        self._state = SensorsState(seed, tuple(begun))
        return self._shown(truths)

    def tick(self, seen: controller.Measurement) -> tuple[Array, Array]:
        """Update all sensors at the end of a tick.

        Args:
            seen: measurement at the end of the tick, exact.

        Returns:
            Readings of all sensors, one after the other, and the true values at the same instant.
        """
        seed, states = self._state.seed, self._state.sensors
        if not states:
            return self.begin(seen, seed)
        truths = [sensor.truth(seen) for sensor in self._sensors]
        rows = zip(self._sensors, states, truths, strict=True)
        self._state = SensorsState(seed, tuple(sensor.next(state, x, seed) for sensor, state, x in rows))
        return self._shown(truths)

    def _shown(self, truths: list[Array]) -> tuple[Array, Array]:
        return np.concatenate([state.reading for state in self._state.sensors]), np.concatenate(truths)

    @property
    def readings(self) -> dict[str, Array]:
        """Present readings by the names of the sensors; empty before the first tick."""
        pairs = zip(self._sensors, self._state.sensors, strict=False)
        return {sensor.name: read_only(state.reading) for sensor, state in pairs}

    def through(self, seen: controller.Measurement, names: Iterable[str]) -> controller.Measurement:
        """Return a measurement with readings in place of true values.

        Args:
            seen: the measurement, exact.
            names: of the sensors whose readings are used; of two for one value, the last.

        Raises:
            InputError: there is no such sensor.
        """
        known = {sensor.name: sensor for sensor in self._sensors}
        for name in names:
            if name not in known:
                raise InputError(f"there is no sensor '{name}'; there are: {', '.join(known) or 'none'}")
            seen = known[name].through(seen, self.readings[name])
        return seen

    @property
    def state(self) -> SensorsState:
        """State of all sensors; setting a state of sensors with other delays or sizes raises InputError."""
        return self._state

    @state.setter
    def state(self, state: SensorsState) -> None:
        here = [(sensor.delay_ticks, size) for sensor, size in zip(self._sensors, self._sizes, strict=True)]
        saved = [each.waiting.shape for each in state.sensors]
        if saved != here:
            raise InputError(
                f"the saved state has sensors with (ticks of delay, values) {saved}; here they have {here}"
            )
        self._state = state
