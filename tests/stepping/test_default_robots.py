"""The default robots, of wrinkling film with frames and fused necks, in their scenarios, with few steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.results.result import RunResult


def few(*names: str) -> dict[str, Any]:
    return {"mode": "quasistatic", **{f"phase.{name}.increments": 5 for name in names}}


def tip(result: RunResult, phase: str) -> np.ndarray[Any, Any]:
    """Return the tip's position at the end of a phase [m]."""
    row = int(np.flatnonzero(result.phase == result.stage.phase_names.index(phase))[-1])
    return np.asarray(result.tip_position[row])


@pytest.mark.long
def test_the_reference_scenario_ends_where_140_increments_lead_it() -> None:
    result = cosim.run("ur5e_hexagon_arm", overrides=few("inflate", "turn", "lift", "reach"), error=False)
    assert result.status == "completed"
    # with more increments, and in the dynamic mode: the same to the last digit
    assert tip(result, "inflate") == pytest.approx([0.3, 0.0, 0.5635], abs=2e-4)
    assert tip(result, "turn") == pytest.approx([0.3531, 0.0, 0.5781], abs=2e-4)
    assert tip(result, "lift")[2] == pytest.approx(0.59, abs=1e-4)
    assert tip(result, "reach") == pytest.approx([0.45, 0.15, 0.55], abs=1e-4)
    assert result.summary["warnings"] == []
    strains = [phase["stiffener"] for phase in result.summary["phases"]]
    assert 0.02 < max(strain["peak_strain"] for strain in strains) < 0.8 * strains[0]["strength_strain"]


def test_a_load_on_the_light_arm_is_lifted_back() -> None:
    result = cosim.run("light_hexagon_arm", overrides=few("inflate", "turn", "load", "lift"), error=False)
    assert result.status == "completed"
    assert 0.035 < result.summary["soft_weight_N"] / 9.81 < 0.06
    turned, loaded, lifted = (tip(result, phase)[2] for phase in ("turn", "load", "lift"))
    assert turned - loaded == pytest.approx(11.6e-3, abs=3e-4)
    assert lifted == pytest.approx(turned, abs=2e-4)
    assert float(np.min(result.cable_tension_N[-1])) > 0.5
