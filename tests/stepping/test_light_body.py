"""A light ball that falls on a film: a run warns that it hits like a heavier one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim

SCENARIO = """
schema = 2
title = "a ball falls on two units"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [] }
fidelity = "lumped"
clock = { tick_s = 0.004 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [1.0, 0.0, 0.0] }
pressure_Pa = 30e3

[[object]]
name = "ball"
shape = "sphere"
size_m = [0.015]
position_m = [0.41, 0.0, 0.62]
mass_kg = 0.001

[[phase]]
name = "drop"
duration_s = 0.12
pressure_Pa = 30e3
"""
MASS_kg, DROP_M, RADIUS_M = 0.001, 0.012, 0.015


@pytest.fixture(scope="module")
def dropped(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a function that drops the ball and returns the result."""
    file: Path = tmp_path_factory.mktemp("ball") / "ball.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    film = cosim.Simulation(file).snapshot.node_position
    top = film[np.hypot(film[:, 0] - 0.41, film[:, 1]) < RADIUS_M, 2].max()
    place = [0.41, 0.0, float(top) + RADIUS_M + DROP_M]

    def run(tick_s: float) -> cosim.RunResult:
        return cosim.run(file, overrides={"clock.tick_s": tick_s, "object.ball.position_m": place})

    return run


def test_a_run_warns_of_a_light_ball_that_hits_like_a_heavy_one_and_the_remedy_works(dropped: Any) -> None:
    """With the tick of the warning the film's impulse is at most that of a full rebound."""
    summary = dropped(0.004).summary
    assert summary["max_contact_ratio"] > 10.0
    (warning,) = [text for text in summary["warnings"] if "times as heavy" in text]
    result = dropped(float(re.findall(r"set clock\.tick_s = ([\de.-]+)", warning)[0]))
    assert not any("times as heavy" in text for text in result.summary["warnings"])
    force = result.body_contact_force[:, result.stage.body_names.index("ball"), 2]
    arriving = MASS_kg * np.sqrt(2.0 * 9.81 * DROP_M)
    assert 0.0 < np.trapezoid(force, result.time_s) < 2.0 * arriving + MASS_kg * 9.81 * 0.12
