"""x"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

from cosim.config.schema.devices import PumpTable
from cosim.soft.elements.gas import SealedGas, leak


@final
@dataclass(frozen=True)
class Pump:
    """What a pump, its switch and its valve can do.

    Args:
        table: of the scenario.
        delay_ticks: age of what the switch sees.
    """

    table: PumpTable
    delay_ticks: int = 0

    def standing(self, pressure_Pa: float) -> PumpState:
        """Return the state of a pump that is off beside a gauge pressure that has stood for long."""
        return PumpState(DelayLine.filled(pressure_Pa, self.delay_ticks))

    def switched(self, state: PumpState, pressure_Pa: float, setpoint_Pa: float) -> PumpState:
        """Return the state after the switch has taken in one more reading.

        Args:
            state: before.
            pressure_Pa: gauge pressure now.
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
        """Return state and gas after pump and valve have worked for a while as they are switched.

        Args:
            state: says whether they are on.
            gas: before.
            volume_m3: of the chamber.
            step_s: time.
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
    """Where a pump is.

    Args:
        sensor: readings on their way to the switch [Pa].
        on: whether the pump runs.
        venting: whether the valve is open.
        starts: how often it was switched on.
        delivered_kg: mass delivered so far.
        on_s: time for which it ran.
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
    """Values on their way, the oldest first.

    Args:
        waiting: one value per tick of the delay; none without delay.
    """

    waiting: tuple[float, ...] = ()

    @classmethod
    def filled(cls, value: float, ticks: int) -> DelayLine:
        """Return a line of a number of ticks in which a value has stood for long."""
        return cls((value,) * ticks)

    def passed(self, value: float) -> tuple[float, DelayLine]:
        """Return what comes out when a value goes in, and the line afterwards."""
        oldest, *waiting = (*self.waiting, value)
        return oldest, DelayLine(tuple(waiting))


@final
@dataclass(frozen=True)
class PumpDriveState:
    """Where a pump is in a run.

    Args:
        setpoint_Pa: of the present phase; None: it does not work.
        pump: of the pump; None before it first works.
    """

    setpoint_Pa: float | None = None
    pump: PumpState | None = None


@final
class PumpDrive:
    """One pump.

    Args:
        pump: what it can do.
        chamber: index of the chamber.
    """

    def __init__(self, pump: Pump, chamber: int) -> None:
        self.name, self.pump, self.chamber = pump.table.name, pump, chamber
        self.state = PumpDriveState()
        """What the next tick depends on."""

    def begin(self, setpoint_Pa: float | None, pressure_Pa: float) -> None:
        """Begin a phase.

        Args:
            setpoint_Pa: None: it does not work.
            pressure_Pa: gauge, in the chamber at present.
        """
        pump = self.state.pump
        if pump is None:
            pump = self.pump.standing(pressure_Pa)
        elif self.state.setpoint_Pa is None:
            # the sensor has looked on all the time
            pump = replace(pump, sensor=self.pump.standing(pressure_Pa).sensor)
        if setpoint_Pa is None:
            pump = replace(pump, on=False, venting=False)
        self.state = PumpDriveState(setpoint_Pa, pump)

    def work(self, gas: SealedGas, volume_m3: float, step_s: float, commanded_Pa: float | None) -> SealedGas:
        """Return the gas after the pump has worked for a tick.

        Args:
            gas: before.
            volume_m3: of the chamber.
            step_s: length of the tick.
            commanded_Pa: setpoint by a controller, in place of the phase's.
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
