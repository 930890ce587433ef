"""Closing a loop on the tip's measured position: the law, an arm that sags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cosim
from cosim.config.loading import load_scenario
from cosim.devices.feedback import TipFollower
from cosim.errors import InputError, ScenarioError
from tests.devices.test_control import seen

NAME = "tip_path_control"


def test_the_flange_goes_by_the_gains_times_the_error() -> None:
    law = TipFollower(0.5, 3.0, 0.02)
    here = seen(tip_wanted=np.array([0.01, np.nan, 0.0]), tip_position=np.array([0.0, 5.0, 0.002]))
    state, command = law.act(law.start(here), here)
    # 3 / s times the error, and half of its change since zero within 20 ms; y is free
    assert command.flange_twist == pytest.approx((0.28, 0.0, -0.056, 0.0, 0.0, 0.0))
    _, command = law.act(state, here)
    assert command.flange_twist == pytest.approx((0.03, 0.0, -0.006, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="needs a tip_path or tip_target"):
        law.act(state, seen())


def test_the_loop_takes_out_a_sag_that_nobody_has_planned() -> None:
    shorter = {"phase.reach.duration_s": 0.4, "phase.reach.settle_s": 0.1, "clock.tick_s": 0.01}
    scenario = load_scenario(NAME, shorter)
    path = scenario.phases[2].tip_path
    assert path is not None
    simulation, course, errors = cosim.Simulation(scenario), path.course(), []
    for tick in range(230):  # 50 to reach, 100 to hold, then along the path
        simulation.step(1)
        wanted = course.at(max(0.0, (tick - 149) * 0.01)).position
        errors.append(float(np.linalg.norm(simulation.snapshot.tip_position - wanted)))
    before, after = errors[49], np.array(errors[-80:])
    assert before > 3e-3
    assert np.sqrt((after**2).mean()) < 1e-3


def test_a_follower_needs_a_phase_that_says_where_the_tip_goes() -> None:
    scenario = load_scenario(NAME)
    with pytest.raises(ScenarioError, match=r"phase\.hold\.control: 'tip' follows a tip_path"):
        load_scenario(replace(scenario, phases=(replace(scenario.phases[1], tip_target=None),)))
