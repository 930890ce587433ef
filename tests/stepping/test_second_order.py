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
duration_s = 0.12
flange_shift_m = [0.013, 0.0, 0.0]
"""
EVERY_s = 0.004


def moved(path: Path, tick_s: float, scheme: str) -> tuple[Array, Array, Array]:
    """Return where tip and flange are every 4 ms, (k, 3) [m] each, and the force on the flange (k, 3) [N]."""
    # without losses of the film the force rings for ever, in modes that no tick resolves
    changes = {"clock.tick_s": tick_s, "coupling.scheme": scheme, "soft_robot.film.loss_factor": 0.05}
    result = cosim.run(path, overrides=changes, error=False)
    every = round(EVERY_s / tick_s)
    return result.tip_position[::every], result.flange_position[::every], result.flange_force[::every]


@pytest.mark.parametrize("scheme", ["staggered", pytest.param("iterated", marks=pytest.mark.long)])
def test_tip_flange_and_force_are_of_second_order(tmp_path: Path, scheme: str) -> None:
    path = tmp_path / "moved.toml"
    path.write_text(MOVED, encoding="utf-8")
    ticks = (0.002, 0.001, 0.0005)
    runs = [moved(path, tick_s, scheme) for tick_s in ticks]
    for which, (finest, bound) in enumerate(zip(runs[-1], (1e-5, 1e-5, 0.02), strict=True)):
        away = [run[which] - finest for run in runs[:2]]
        coarse, fine = (float(np.sqrt((each**2).sum(axis=1).mean())) for each in away)
        # of order p the finest run's own error makes 2^p + 1 of a ratio of 2^p
        assert np.log2(coarse / fine - 1.0) > 1.8
        # servos that were asked for the speed of a tick's begin left 0.4 mm at 4 ms
        assert coarse < bound


@pytest.mark.long
def test_ticks_take_little_of_a_jerk() -> None:
    jerk = {"name": "jerk", "duration_s": 0.1, "settle_s": 0.5, "flange_shift_m": [0.03, 0.0, 0.0]}
    changed = {"clock.tick_s": 0.002, "start.pressure_Pa": 20e3, "phase": [jerk]}
    summary = cosim.run("ur5e_hexagon_arm", overrides=changed).summary
    energy = summary["phases"][-1]["energy"]
    lost = sum(energy[name] for name in ("damping_J", "air_drag_J", "numerical_J"))
    assert 0.0 < energy["numerical_J"] < 0.05 * lost
    for mode in summary["phases"][-1]["modes"]:
        assert abs(mode["numerical_decay_per_s"]) < 0.02 * mode["declared_decay_per_s"]
