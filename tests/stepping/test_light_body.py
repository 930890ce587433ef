"""A light ball that falls on a film takes the impulse that the film gives it."""

from __future__ import annotations

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
MASS_kg, DROP_M, RADIUS_M, TICK_S = 0.001, 0.012, 0.015, 0.004


@pytest.fixture(scope="module")
def dropped(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a function that drops the ball and returns the result."""
    file: Path = tmp_path_factory.mktemp("ball") / "ball.toml"
    file.write_text(SCENARIO, encoding="utf-8")
    film = cosim.Simulation(file).snapshot.node_position
    top = film[np.hypot(film[:, 0] - 0.41, film[:, 1]) < RADIUS_M, 2].max()
    place = [0.41, 0.0, float(top) + RADIUS_M + DROP_M]

    def run(tick_s: float, scheme: str) -> cosim.RunResult:
        changes = {"clock.tick_s": tick_s, "object.ball.position_m": place, "coupling.scheme": scheme}
        return cosim.run(file, overrides=changes)

    return run


@pytest.mark.parametrize("scheme", ["staggered", "iterated"])
def test_a_light_ball_takes_the_impulse_that_the_film_gives(dropped: Any, scheme: str) -> None:
    """It took 700 times its momentum, and the iterated exchange ended in a ConvergenceError."""
    result = dropped(TICK_S, scheme)
    ball = result.stage.body_names.index("ball")
    force, velocity = (
        result.body_contact_force[:, ball],
        np.diff(result.body_position[:, ball], axis=0) / TICK_S,
    )
    assert not force[[0, 1]].any()
    # a tick of n steps ends faster than it is in the mean, by (n - 1) / (2 n) of what its load adds
    lag = 3.0 / 8.0 if scheme == "staggered" else 0.0
    given = TICK_S * (force[:-1].sum(axis=0) + (1.0 - lag) * force[-1])
    weight = MASS_kg * 9.81 * TICK_S * (len(velocity) - 1)
    assert given[2] - weight == pytest.approx(MASS_kg * (velocity[-1] - velocity[0])[2], rel=1e-6)
    arriving = MASS_kg * np.sqrt(2.0 * 9.81 * DROP_M)
    assert 0.5 * arriving < given[2] < 2.0 * arriving + weight
    assert result.summary["max_contact_ratio"] > 5.0  # of pieces of a tick, where the film is hit
    assert result.summary["max_momentum_error"] < 1e-10
    # the film hardly feels a gram: before, the tip moved by 8 mm
    assert np.ptp(result.tip_position, axis=0).max() < 5e-4
