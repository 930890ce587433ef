"""Commands of a phase are those between its ends, and loads say what a command does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.errors import InputError
from cosim.plan.robot_command import CommandRamp, SoftCommand, loads_of
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas

BEGIN = SoftCommand((1e4, 2e4), (None, None), (1.0, 0.0), (None, None))
GAS = SealedGas(1.1e5, 1e-3, 1.4, 1e5, 293.0)
FORCE = np.ones((4, 3))
GRAVITY = (0.0, 0.3, -9.81)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"pressure_Pa": (3e4, 2e4)},
        {"pressure_Pa": (3e4, 2e4), "cable_tension_N": (0.0, 5.0)},
        {"nodal_force": FORCE, "pressure_Pa": (2e4, 0.0)},
    ],
)
def test_the_ramp_is_the_interpolation_of_loads(changes: dict[str, Any], share: float) -> None:
    end = replace(BEGIN, **changes)
    found = loads_of(CommandRamp(BEGIN, end).at(share), GRAVITY)
    expected = loads_of(BEGIN, GRAVITY).interpolated(loads_of(end, GRAVITY), share)
    assert found.pressure_Pa == pytest.approx(expected.pressure_Pa, rel=1e-15)
    assert found.cable_tension_N == pytest.approx(expected.cable_tension_N, rel=1e-15)
    assert found.gravity == GRAVITY
    assert (found.gas, found.cable_length_m) == (None, ())
    np.testing.assert_array_equal(found.nodal_force, expected.nodal_force)


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
    assert found == Loads(2e4, (), GRAVITY)


def test_what_is_planned_has_a_value_for_each_chamber_and_cable() -> None:
    found = SoftCommand.planned(Loads(3e3, (1.0, 2.0), gas=GAS, nodal_force=FORCE), 3)
    assert (found.pressure_Pa, found.gas) == ((3e3,) * 3, (None,) * 3)
    assert (found.cable_tension_N, found.cable_length_m) == ((1.0, 2.0), (None, None))
    assert found.nodal_force is FORCE


def test_a_cable_that_is_asked_to_push_is_refused() -> None:
    with pytest.raises(InputError, match="cannot push"):
        loads_of(replace(BEGIN, cable_tension_N=(1.0, -1.0)), GRAVITY)
