"""Loads of a phase are those between its ends, whatever of them changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.soft.body.loads import LoadRamp, Loads
from cosim.soft.elements.gas import SealedGas

BEGIN = Loads(1e4, (1.0, 0.0))
GAS = SealedGas(1.1e5, 1e-3, 1.4, 1e5, 293.0)
FORCE = np.ones((4, 3))


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"pressure_Pa": 3e4},
        {"pressure_Pa": (3e4, 2e4), "cable_tension_N": (0.0, 5.0)},
        {"gravity": (0.0, 1.0, -9.0)},
        {"nodal_force": FORCE, "pressure_Pa": 2e4},
        {"gas": GAS},
        {"cable_length_m": (0.2, None)},
    ],
)
def test_the_ramp_is_the_interpolation(changes: dict[str, Any], share: float) -> None:
    end = replace(BEGIN, **changes)
    found, expected = LoadRamp(BEGIN, end).at(share), BEGIN.interpolated(end, share)
    assert found.pressure_Pa == pytest.approx(expected.pressure_Pa, rel=1e-15)
    assert found.cable_tension_N == pytest.approx(expected.cable_tension_N, rel=1e-15)
    assert found.gravity == pytest.approx(expected.gravity, rel=1e-15)
    assert (found.gas, found.cable_length_m) == (expected.gas, expected.cable_length_m)
    np.testing.assert_array_equal(found.nodal_force, expected.nodal_force)


def test_loads_that_stay_are_the_same_object() -> None:
    end = replace(BEGIN)
    assert LoadRamp(BEGIN, end).at(0.4) is end
