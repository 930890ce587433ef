"""Torques that runs report are those of the arm's motion, whatever the tick."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.joint_torque import run

SHARE = 0.02  # of the joint's largest torque


@pytest.mark.parametrize(
    ("arm", "motion", "tick_ms"),
    [
        ("ur5e", "move", 4.0), ("ur5e", "move", 0.5), ("ur10", "rest", 4.0), ("ur3", "move", 4.0),
        ("panda", "move", 2.0), ("xarm7", "move", 4.0),
    ],
)  # fmt: skip
def test_torques_of_run_plan_and_inverse_dynamics_agree(
    arm: str, motion: str, tick_ms: float, tmp_path: Path
) -> None:
    found = run(arm, motion, 1e-3 * tick_ms, tmp_path)
    assert not found.saturated
    assert found.apart(found.of_motion) < SHARE
    assert found.apart(found.planned) < SHARE


@pytest.mark.parametrize(("arm", "tick_ms"), [("ur5e", 4.0), ("panda", 2.0), ("ur3", 1.0)])
def test_a_servo_at_its_limit_gives_its_limit_and_no_more(arm: str, tick_ms: float, tmp_path: Path) -> None:
    found = run(arm, "hurry", 1e-3 * tick_ms, tmp_path)
    assert found.saturated
    assert np.all(np.abs(found.reported) <= found.limit)
    assert found.apart(found.of_motion) < SHARE
