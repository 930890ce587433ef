"""Scenarios that demonstrate something do it: shortened runs, and what must be seen in them."""

from __future__ import annotations

from typing import Any

import numpy as np

import cosim
from cosim.result import RunResult
from cosim.scenario.loading import load_scenario


def shortened(name: str, seconds: dict[str, float], **overrides: Any) -> RunResult:
    """Run a scenario at 4 ms with other durations of its phases, and without settling after them.

    Args:
        name: of the scenario.
        seconds: duration of each phase that is kept.
        overrides: further changes; dots in keys are written as two underscores.
    """
    changes: dict[str, Any] = {"clock.tick_s": 0.004}
    changes |= {key.replace("__", "."): value for key, value in overrides.items()}
    for phase in load_scenario(name).phases:
        changes[f"phase.{phase.name}.duration_s"] = seconds[phase.name]
        changes[f"phase.{phase.name}.settle_s"] = 0.0
    result = cosim.run(name, overrides=changes)
    assert result.status == "completed"
    return result


def at_end_of(result: RunResult, phase: str) -> int:
    """Return the row at the end of a phase."""
    return int(np.flatnonzero(result.phase == result.stage.phase_names.index(phase))[-1])


def test_the_arm_reaches_around_the_bar() -> None:
    seconds = {"inflate": 0.1, "wind": 1.2, "hook": 0.6}
    result = shortened("arm_around_bar", seconds, start__pressure_Pa=30e3)
    bar = load_scenario("arm_around_bar").objects[0]
    radius = bar.size_m[0]
    before, after = at_end_of(result, "inflate"), at_end_of(result, "hook")
    near, far = bar.position_m[0] - radius, bar.position_m[0] + radius
    assert result.tip_position[before, 0] < near - 0.04
    assert result.tip_position[after, 0] > far + 0.01
    assert result.tip_direction[after, 2] > 0.5  # it has come up on the far side
    assert result.contact_force_N.max() > 3.0
    assert result.contact_depth_m.max() < 1e-3


def test_the_corner_of_a_table_does_not_slip_into_the_finger() -> None:
    seconds = {"inflate": 0.05, "press": 0.6, "slide": 0.2, "leave": 0.4}
    result = shortened("gripper_on_table_edge", seconds, start__pressure_Pa=30e3)
    pressed, slid = (result.contact_force_N[at_end_of(result, name)] for name in ("press", "slide"))
    assert pressed > 10.0
    assert slid > 10.0
    assert result.contact_depth_m.max() < 1e-3
    assert result.contacts[-1] == 0
