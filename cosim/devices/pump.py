"""A pump that a pressure switch turns on and off, with a vent valve, on the gas of a chamber. The switch sees
the gauge pressure of some ticks ago. With the setpoint r and the band b the pump switches on below r - b/2
and off above r + b/2. The valve opens above r + v and closes below r; without v there is no valve. While on,
the pump delivers q (1 - p / p_max) kg/s against the gauge pressure p (the usual linear characteristic of a
diaphragm pump; q without p_max). At constant volume and temperature dp/dm = R T / V, so a step has the closed
form p(t) = p_max - (p_max - p_0) exp(-q R T t / (V p_max)) at any length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

from cosim.config.schema.devices import PumpTable
from cosim.soft.elements.gas import SealedGas, leak


@final
@dataclass(frozen=True)
class Pump:
    """A pump with its switch and its valve.

    Args:
        table: of the scenario.
        delay_ticks: age of the pressure that the switch sees.
    """

    table: PumpTable
    delay_ticks: int = 0

    def standing(self, pressure_Pa: float) -> PumpState:
        """Return the state of a pump that is off, after a gauge pressure that has been constant."""
        return PumpState(DelayLine.filled(pressure_Pa, self.delay_ticks))

    def switched(self, state: PumpState, pressure_Pa: float, setpoint_Pa: float) -> PumpState:
        """Return the state after another reading of the switch.

        Args:
            state: before the reading.
            pressure_Pa: present gauge pressure.
            setpoint_Pa: r.
        """
        seen, sensor = state.sensor.passed(pressure_Pa)
        half, vent = 0.5 * self.table.band_Pa, self.table.vent_above_Pa
        on = seen < setpoint_Pa - half or (state.on and seen <= setpoint_Pa + half)
        above = vent is not None and seen > setpoint_Pa + vent
        open_ = above or (state.venting and seen >= setpoint_Pa)
        started = state.starts + (on and not state.on)
        return replace(state, sensor=sensor, on=on, venting=open_, starts=started)

    def worked(
        self, state: PumpState, gas: SealedGas, volume_m3: float, step_s: float
    ) -> tuple[PumpState, SealedGas]:
        """Return state and gas after a time step with pump and valve as they are switched.

        Args:
            state: with the switches.
            gas: before the step.
            volume_m3: of the chamber.
            step_s: time step.
        """
        if state.venting:
            gas = leak(gas, volume_m3, self.table.vent_kg_s_Pa, step_s)
        if not state.on:
            return state, gas
        here = gas.at(volume_m3)
        mass = self._delivered(here, step_s)
        done = replace(state, delivered_kg=state.delivered_kg + mass, on_s=state.on_s + step_s)
        return done, here.with_mass(here.mass_kg + mass)

    def _delivered(self, gas: SealedGas, step_s: float) -> float:
        flow, most = self.table.flow_kg_s, self.table.pressure_max_Pa
        if most is None:
            return flow * step_s
        rise = gas.pressure_Pa / gas.mass_kg  # dp/dm = R T / V
        room = max(most - (gas.pressure_Pa - gas.ambient_Pa), 0.0)
        return -room / rise * math.expm1(-flow * rise * step_s / most)


@final
@dataclass(frozen=True)
class PumpState:
    """State of a pump.

    Args:
        sensor: readings that the switch has not seen yet [Pa].
        on: whether the pump runs.
        venting: whether the valve is open.
        starts: number of times that it was switched on.
        delivered_kg: mass delivered so far.
        on_s: time for which it has run.
    """

    sensor: DelayLine
    on: bool = False
    venting: bool = False
    starts: int = 0
    delivered_kg: float = 0.0
    on_s: float = 0.0


@final
@dataclass(frozen=True)
class DelayLine:
    """Delayed values, the oldest first.

    Args:
        waiting: one value per tick of the delay; none without delay.
    """

    waiting: tuple[float, ...] = ()

    @classmethod
    def filled(cls, value: float, ticks: int) -> DelayLine:
        """Return a line of a number of ticks that is filled with one value."""
        return cls((value,) * ticks)

    def passed(self, value: float) -> tuple[float, DelayLine]:
        """Return the oldest value, and the line with a new value in its place at the end."""
        oldest, *waiting = (*self.waiting, value)
        return oldest, DelayLine(tuple(waiting))


@final
@dataclass(frozen=True)
class PumpDriveState:
    """State of a pump in a run.

    Args:
        setpoint_Pa: of the present phase; None: the pump is inactive.
        pump: state of the pump; None before it is first active.
    """

    setpoint_Pa: float | None = None
    pump: PumpState | None = None


@final
class PumpDrive:
    """One pump.

    Args:
        pump: its data.
        chamber: index of the chamber.
    """

    def __init__(self, pump: Pump, chamber: int) -> None:
        self.name, self.pump, self.chamber = pump.table.name, pump, chamber
        self.state = PumpDriveState()
        """State, on which the next tick depends."""

    def begin(self, setpoint_Pa: float | None, pressure_Pa: float) -> None:
        """Begin a phase.

        Args:
            setpoint_Pa: of the phase; None: the pump is inactive.
            pressure_Pa: present gauge pressure in the chamber.
        """
        pump = self.state.pump
        if pump is None:
            pump = self.pump.standing(pressure_Pa)
        elif self.state.setpoint_Pa is None:
            # the sensor has measured while the pump was inactive
            pump = replace(pump, sensor=self.pump.standing(pressure_Pa).sensor)
        if setpoint_Pa is None:
            pump = replace(pump, on=False, venting=False)
        self.state = PumpDriveState(setpoint_Pa, pump)

    def work(self, gas: SealedGas, volume_m3: float, step_s: float, commanded_Pa: float | None) -> SealedGas:
        """Return the gas after a tick with the pump.

        Args:
            gas: before the tick.
            volume_m3: of the chamber.
            step_s: length of the tick.
            commanded_Pa: setpoint of a controller, in place of the phase's; None: that of the phase.
        """
        setpoint, pump = self.state.setpoint_Pa, self.state.pump
        if commanded_Pa is not None:
            setpoint = commanded_Pa
        if setpoint is None or pump is None:
            return gas
        pump = self.pump.switched(pump, gas.gauge_pressure(volume_m3), setpoint)
        pump, gas = self.pump.worked(pump, gas, volume_m3, step_s)
        self.state = PumpDriveState(setpoint, pump)
        return gas
