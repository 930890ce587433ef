"""Arm and soft robot in motion are of second order in the tick, and ticks take next to no energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array

MOVED = """
schema = 2
title = "Two units that a UR5e moves smoothly"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [
  { name = "right", corner = 0, units = [1, 2], capstan_factor = 0.8 }] }
solver = { damping_per_s = 5.0, dynamic_tolerance_N = 1e-8, dynamic_newton_iterations = 50 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 10e3

[[phase]]
name = "move"
duration_s = 0.2
flange_shift_m = [0.025, 0.0, 0.0]
"""
EVERY_s = 0.004


def moved(path: Path, tick_s: float, scheme: str) -> tuple[Array, Array]:
    """Return where tip and flange are every 4 ms: (k, 3) [m] each."""
    result = cosim.run(path, overrides={"clock.tick_s": tick_s, "coupling.scheme": scheme}, error=False)
    every = round(EVERY_s / tick_s)
    return result.tip_position[::every], result.flange_position[::every]


@pytest.mark.parametrize("scheme", ["staggered", "iterated"])
def test_tip_and_flange_are_of_second_order(tmp_path: Path, scheme: str) -> None:
    path = tmp_path / "moved.toml"
    path.write_text(MOVED, encoding="utf-8")
    ticks = (0.004, 0.002, 0.001)
    runs = [moved(path, tick_s, scheme) for tick_s in ticks]
    for which, finest in enumerate(runs[-1]):
        away = [run[which] - finest for run in runs[:2]]
        coarse, fine = (float(np.sqrt((each**2).sum(axis=1).mean())) for each in away)
        # of second order, the finest run's own error makes 5 of a ratio of 4; of first order, 3 of 2
        assert np.log2(coarse / fine) > 2.0
        # servos that were asked for the speed of a tick's begin left 0.4 mm
        assert coarse < 3e-5


def test_ticks_take_little_of_a_jerk() -> None:
    jerk = {"name": "jerk", "duration_s": 0.1, "settle_s": 0.5, "flange_shift_m": [0.03, 0.0, 0.0]}
    summary = cosim.run("ur5e_hexagon_arm", overrides={"start.pressure_Pa": 20e3, "phase": [jerk]}).summary
    energy = summary["phases"][-1]["energy"]
    lost = sum(energy[name] for name in ("damping_J", "air_drag_J", "numerical_J"))
    assert 0.0 < energy["numerical_J"] < 0.05 * lost
    for mode in summary["phases"][-1]["modes"]:
        assert abs(mode["numerical_decay_per_s"]) < 0.02 * mode["declared_decay_per_s"]
