"""Pump with pressure switch: filling a rigid volume, the limit cycle of a delayed switch, the valve."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.config.schema.devices import PumpTable
from cosim.devices.pump import DelayLine, Pump, PumpState
from cosim.soft.elements.gas import SealedGas, STANDARD_ATMOSPHERE_Pa, leak

VOLUME_m3 = 4e-4
TICK_s = 1e-3
TABLE = PumpTable("pump", 2e-5, band_Pa=400.0)
PUMP = Pump(TABLE)
AMBIENT = SealedGas(STANDARD_ATMOSPHERE_Pa, VOLUME_m3)
RISE_Pa_s = TABLE.flow_kg_s * AMBIENT.gas_constant_J_kg_K * AMBIENT.temperature_K / VOLUME_m3


def run(
    pump: Pump, setpoint_Pa: float, ticks: int, leak_kg_s_Pa: float = 0.0, gas: SealedGas = AMBIENT
) -> tuple[Array, Array, PumpState]:
    """Return gauge pressure after each tick, whether the pump ran, and the last state."""
    state = pump.standing(gas.gauge_pressure(VOLUME_m3))
    pressure, on = np.zeros(ticks), np.zeros(ticks, dtype=bool)
    for k in range(ticks):
        state = pump.switched(state, gas.gauge_pressure(VOLUME_m3), setpoint_Pa)
        state, gas = pump.worked(state, gas, VOLUME_m3, TICK_s)
        gas = leak(gas, VOLUME_m3, leak_kg_s_Pa, TICK_s)
        pressure[k], on[k] = gas.gauge_pressure(VOLUME_m3), state.on
    return pressure, on, state


def test_a_delay_line_gives_back_what_went_in_ticks_ago() -> None:
    line, out = DelayLine.filled(-1.0, 2), []
    for value in (1.0, 2.0, 3.0, 4.0):
        seen, line = line.passed(value)
        out.append(seen)
    assert out == [-1.0, -1.0, 1.0, 2.0]
    assert DelayLine.filled(0.0, 0).passed(5.0) == (5.0, DelayLine())


def test_a_rigid_volume_fills_at_the_rate_of_the_gas_law() -> None:
    # dp/dt = q R T / V
    pressure, on, state = run(PUMP, 1e9, 500)
    assert on.all()
    assert pressure == pytest.approx(RISE_Pa_s * TICK_s * np.arange(1, 501), rel=1e-9)
    assert state.delivered_kg == pytest.approx(0.5 * TABLE.flow_kg_s)
    assert state.on_s == pytest.approx(0.5)


@pytest.mark.parametrize("step", [1e-3, 0.05])
def test_against_counter_pressure_filling_is_exponential_whatever_the_step(step: float) -> None:
    pump, gas = Pump(replace(TABLE, pressure_max_Pa=30e3)), AMBIENT
    state = replace(pump.standing(0.0), on=True)
    for _ in range(round(2.0 / step)):
        state, gas = pump.worked(state, gas, VOLUME_m3, step)
    expected = 30e3 * (1.0 - math.exp(-RISE_Pa_s * 2.0 / 30e3))
    assert gas.gauge_pressure(VOLUME_m3) == pytest.approx(expected, rel=1e-9)


def test_a_pump_that_runs_against_too_much_pressure_takes_nothing_out() -> None:
    pump, full = Pump(replace(TABLE, pressure_max_Pa=20e3)), AMBIENT.with_mass(1.3 * AMBIENT.mass_kg)
    state, gas = pump.worked(replace(pump.standing(30e3), on=True), full, VOLUME_m3, TICK_s)
    assert gas.mass_kg == pytest.approx(full.mass_kg, rel=1e-15)
    assert state.delivered_kg == 0.0


@pytest.mark.parametrize("delay", [0, 1, 40])
def test_limit_cycle_of_a_delayed_switch(delay: int) -> None:
    # on: dp/dt = a - p/tau, off: dp/dt = -p/tau; the switch acts on a pressure `lag` old
    conductance = 5e-10
    per_s = conductance * AMBIENT.gas_constant_J_kg_K * AMBIENT.temperature_K / VOLUME_m3
    pump = Pump(TABLE, delay)
    pressure, on, state = run(pump, 20e3, 30_000, conductance)
    assert state.starts == 1 + np.count_nonzero(np.diff(on.astype(int)) == 1)  # on from the first tick
    # the switch reads before the tick, and acts on average half a tick after the crossing
    lag, level = (delay + 0.5) * TICK_s, RISE_Pa_s / per_s
    high = level - (level - 20.2e3) * math.exp(-per_s * lag)
    low = 19.8e3 * math.exp(-per_s * lag)
    period = (math.log(high / low) + math.log((level - low) / (level - high))) / per_s
    steady = slice(15_000, None)
    one_tick = RISE_Pa_s * TICK_s
    assert pressure[steady].max() == pytest.approx(high, abs=one_tick)
    assert pressure[steady].min() == pytest.approx(low, abs=one_tick)
    starts = np.flatnonzero(np.diff(on[steady].astype(int)) == 1)
    measured = float(np.diff(starts).mean()) * TICK_s
    assert measured == pytest.approx(period, abs=3.0 * TICK_s, rel=0.02)


def test_inside_its_band_the_switch_stays_as_it_is() -> None:
    on = replace(PUMP.standing(0.0), on=True)
    for state in (on, replace(on, on=False)):
        for pressure in (19.9e3, 20.1e3):
            assert PUMP.switched(state, pressure, 20e3).on == state.on
    assert not PUMP.switched(on, 20.3e3, 20e3).on
    started = PUMP.switched(replace(on, on=False), 19.7e3, 20e3)
    assert (started.on, started.starts) == (True, 1)


def test_the_valve_lets_a_pressure_down_to_the_setpoint() -> None:
    pump = Pump(replace(TABLE, vent_above_Pa=1e3, vent_kg_s_Pa=2e-8))
    full = AMBIENT.with_mass(1.3 * AMBIENT.mass_kg)
    pressure, on, state = run(pump, 20e3, 2000, gas=full)
    assert not on.any()
    assert not state.venting
    # closed at the first reading below the setpoint
    assert pressure[-1] < 20e3
    assert pressure[-1] == pytest.approx(20e3, abs=60.0)
    assert run(Pump(replace(pump.table, vent_above_Pa=None)), 20e3, 5, gas=full)[0][-1] > 30e3
