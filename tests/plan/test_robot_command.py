"""Commands of a phase are those between its ends, and loads say what a command does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.errors import InputError
from cosim.plan import commands
from cosim.plan.commands import CommandRamp, SoftCommand, loads_of
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas
from tests.soft.wind import Windy, WindyCommand

BEGIN = SoftCommand((1e4, 2e4), (None, None), (1.0, 0.0), (None, None))
GAS = SealedGas(1.1e5, 1e-3, 1.4, 1e5, 293.0)
FORCE = np.ones((4, 3))
GRAVITY = (0.0, 0.3, -9.81)


@pytest.mark.parametrize("fraction", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"pressure_Pa": (3e4, 2e4)},
        {"pressure_Pa": (3e4, 2e4), "cable_tension_N": (0.0, 5.0)},
        {"nodal_force": FORCE, "pressure_Pa": (2e4, 0.0)},
    ],
)
def test_the_ramp_is_the_interpolation_of_loads(changes: dict[str, Any], fraction: float) -> None:
    end = replace(BEGIN, **changes)
    found = loads_of(CommandRamp(BEGIN, end).at(fraction), GRAVITY)
    expected = loads_of(BEGIN, GRAVITY).interpolated(loads_of(end, GRAVITY), fraction)
    assert found.pressure_Pa == pytest.approx(expected.pressure_Pa, rel=1e-15)
    assert found.cable_tension_N == pytest.approx(expected.cable_tension_N, rel=1e-15)
    assert found.gravity == GRAVITY
    assert (found.gas, found.cable_length_m) == ((), ())
    np.testing.assert_array_equal(found.nodal_force, expected.nodal_force)


def test_what_stays_is_exactly_as_commanded_while_something_else_changes() -> None:
    begin = replace(BEGIN, pressure_Pa=(0.1, 2e4), cable_tension_N=(0.3, 0.0))
    ramp = CommandRamp(begin, replace(begin, pressure_Pa=(0.1, 3e4)))
    first, last = loads_of(ramp.begin, GRAVITY), loads_of(ramp.end, GRAVITY)
    for fraction in (k / 97 for k in range(97)):
        asked, loads = ramp.at(fraction), first.interpolated(last, fraction)
        assert (asked.pressure_Pa[0], asked.cable_tension_N) == (0.1, (0.3, 0.0))
        assert (loads.pressure_Pa[0], loads.cable_tension_N, loads.gravity) == (0.1, (0.3, 0.0), GRAVITY)


def test_commands_that_stay_are_the_same_object() -> None:
    end = replace(BEGIN)
    assert CommandRamp(BEGIN, end).at(0.4) is end


def test_loads_hold_what_is_commanded_of_each_chamber_and_cable() -> None:
    loads = loads_of(replace(BEGIN, gas=(GAS, None), cable_length_m=(None, 0.2), nodal_force=FORCE), GRAVITY)
    assert (loads.pressures(2), loads.gases(2)) == ((1e4, 2e4), (GAS, None))
    assert (loads.cable_tension_N, loads.cable_length_m) == ((1.0, 0.0), (None, 0.2))
    assert loads.nodal_force is FORCE
    assert loads.gravity == GRAVITY


def test_one_chamber_at_a_given_pressure_is_all_that_simple_loads_hold() -> None:
    found = loads_of(SoftCommand((2e4,), (None,), (), ()), GRAVITY)
    assert found == Loads((2e4,), (), GRAVITY)


def test_an_unsealed_command_asks_for_the_same_pressures_without_gas() -> None:
    asked = replace(BEGIN, gas=(GAS, None), nodal_force=FORCE)
    found = asked.unsealed()
    assert found.gas == (None, None)
    assert found.unsealed() is found
    assert found.nodal_force is FORCE
    assert (found.pressure_Pa, found.cable_tension_N) == (asked.pressure_Pa, asked.cable_tension_N)


def test_a_cable_that_is_asked_to_push_is_refused() -> None:
    with pytest.raises(InputError, match="cannot push"):
        loads_of(replace(BEGIN, cable_tension_N=(1.0, -1.0)), GRAVITY)


def test_a_field_more_is_ramped_as_that_of_the_end_and_needs_a_load(monkeypatch: pytest.MonkeyPatch) -> None:
    begin, end = (WindyCommand(**vars(BEGIN), wind_m_s=speed) for speed in (0.0, 3.0))
    asked = CommandRamp(begin, replace(end, pressure_Pa=(3e4, 2e4))).at(0.5)
    assert isinstance(asked, WindyCommand)
    assert asked.wind_m_s == 3.0
    assert replace(asked, gas=(GAS, None)).unsealed().wind_m_s == 3.0
    with pytest.raises(TypeError, match="wind_m_s"):
        loads_of(asked, GRAVITY)
    monkeypatch.setattr(commands, "Loads", Windy)
    loads = loads_of(asked, GRAVITY)
    assert isinstance(loads, Windy)
    assert loads.wind_m_s == 3.0
