"""Commands from outside about gas, and phases that seal chambers or open them: none is ignored in silence."""

from __future__ import annotations

from pathlib import Path

import pytest

import cosim
from cosim import Command
from cosim.errors import InputError
from tests.devices import device_parts

CHAMBER = "chamber"
INFLATE = """
[[phase]]
name = "inflate"
duration_s = 0.04
pressure_Pa = 20e3
"""
SEAL = """
[[phase]]
name = "seal"
duration_s = 0.04
gas = "sealed"
"""
OPEN = """
[[phase]]
name = "open"
duration_s = 0.04
gas = "prescribed"
pressure_Pa = 18e3
"""
SHUT = SEAL.replace('"seal"', '"shut"')
TICKS = 10
"""Of each of these phases."""


def begun(tmp_path: Path, *parts: str) -> cosim.Simulation:
    """Return a simulation of a small film after the first tick of its phases."""
    # its gas is to follow commands, not the film's swing, of which BDF2 takes next to nothing
    changes = {"start.pressure_Pa": 20e3, "solver.integrator": "implicit_euler"}
    here = cosim.Simulation(device_parts.scenario(tmp_path, *parts), overrides=changes)
    here.step(1)
    return here


def test_a_pressure_that_a_phase_seals_in_before_it_is_reached_is_refused(tmp_path: Path) -> None:
    here = begun(tmp_path, INFLATE, SEAL)
    command = Command(pressure_Pa={CHAMBER: 16e3})
    text = (
        r"step: pressure_Pa of 'chamber': phase 'seal' seals its gas; command gas_kg; it begins after "
        "9 of these 15 ticks: end the step there"
    )
    for ticks, refused in ((15, text), (10, "10 ticks")):
        with pytest.raises(InputError, match=refused):
            here.step(command, ticks=ticks)
        assert here.snapshot.tick == 1
    here.step(command, ticks=9)
    assert here.measure().pressure_Pa == (16e3,)
    assert here.measure().limits == ()


def test_what_a_phase_ends_is_named_until_the_next_command(tmp_path: Path) -> None:
    here = begun(tmp_path, INFLATE, SEAL, OPEN, SHUT)
    here.step(Command(pressure_Pa={CHAMBER: 16e3}), ticks=9)
    here.step(1)
    sealed = here.measure()
    assert sealed.limits == ("pressure_Pa of 'chamber': phase 'seal' seals its gas; command gas_kg",)
    assert sealed.pressure_Pa == pytest.approx((16e3,), rel=0.05)  # in a moving film
    saved = here.save()
    (amount,) = sealed.gas_kg
    assert amount is not None
    here.step(Command(gas_kg={CHAMBER: 1.01 * amount}), ticks=9)
    more = here.measure()
    assert more.limits == ()
    here.step(1)
    opened = here.measure()
    assert opened.limits == ("gas_kg of 'chamber': phase 'open' gives its pressure; command pressure_Pa",)
    # as planned from what there is, a smooth ramp: neither back to 16 kPa nor at once to the 18 of the phase
    assert opened.pressure_Pa[0] == pytest.approx(more.pressure_Pa[0], abs=0.02 * 2e3)
    assert abs(more.pressure_Pa[0] - 16e3) > 200.0
    here.step(9)
    here.step(1)  # sealed again: with what is there, not with the amount of the phase before
    assert here.measure().pressure_Pa == pytest.approx((18e3,), rel=0.05)
    assert here.measure().limits == opened.limits
    here.restore(saved)
    assert here.measure().limits == sealed.limits


def test_a_pump_that_works_and_an_amount_of_gas_are_not_commanded_together(tmp_path: Path) -> None:
    pumping = SEAL + "pump_pressure_Pa = { main = 21e3 }\n"
    here = begun(tmp_path, device_parts.PUMP, pumping, OPEN, SHUT)
    (amount,) = here.measure().gas_kg
    assert amount is not None
    with pytest.raises(
        InputError, match=r"gas_kg of 'chamber', which pump 'main' fills; command pump_pressure_Pa"
    ):
        here.step(Command(gas_kg={CHAMBER: amount}), ticks=2)
    with pytest.raises(InputError, match=r"pump_pressure_Pa of 'main': phase 'open' gives the pressure of"):
        here.step(Command(pump_pressure_Pa={"main": 22e3}), ticks=2 * TICKS)
    here.step(Command(pump_pressure_Pa={"main": 22e3}), ticks=TICKS - 1)
    here.step(1)  # it once stopped here, as there was no way to take a setpoint back
    (ended,) = here.measure().limits
    assert ended.startswith("pump_pressure_Pa of 'main': phase 'open' gives the pressure of 'chamber'")
    here.step(TICKS)
    # the pump rests in the phase that seals again: an amount is commanded, until a setpoint takes its place
    (amount,) = here.measure().gas_kg
    assert amount is not None
    here.step(Command(gas_kg={CHAMBER: 1.01 * amount}), ticks=2)
    assert here.measure().gas_kg == pytest.approx((1.01 * amount,))
    here.step(Command(pump_pressure_Pa={"main": 30e3}), ticks=5)
    (pumped,) = here.measure().gas_kg
    assert pumped is not None
    flow_kg = 2e-5 * device_parts.TICK_s
    assert pumped - 1.01 * amount == pytest.approx(5 * flow_kg, rel=1e-3)


def test_commands_outlast_phases_and_win_over_devices(tmp_path: Path) -> None:
    phases = device_parts.WINCH + INFLATE, SEAL + device_parts.SHORTER
    here = begun(tmp_path, *phases)
    here.step(Command(cable_tension_N={"corner_0": 0.3}), ticks=9)
    here.step(5)  # a phase that winds the same cable
    assert here.measure().cable_tension_N["corner_0"] == 0.3
    alone = begun(tmp_path, *phases)
    alone.step(14)
    assert alone.measure().cable_tension_N["corner_0"] != 0.3
