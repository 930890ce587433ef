"""Errors of a trade's candidates: the flange force by its moving mean, and their order in the tick."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.trade.candidates import Candidate
from cosim.trade.measuring import Curve, Measured, compared, trace


def pushed(tick_s: float, force_N: Array) -> Curve:
    """Return a curve that stands still under a force along x, one value a tick."""
    count = len(force_N)
    force = np.outer(force_N, [1.0, 0.0, 0.0])
    still, objects = np.zeros((count, 3)), np.zeros((count, 0, 3))
    return Curve(tick_s * np.arange(count), still, objects, force, np.zeros(count), (count - 1,), 0.1, 1.0)


def force_error(here: Curve, there: Curve) -> float:
    return compared(Candidate("other", "time", {}), here, there).force_error_N


def test_the_force_is_compared_by_its_moving_mean() -> None:
    none = np.zeros(201)
    chatter = np.where(np.arange(201) % 2, -1.0, 1.0)  # 1 N at every compared time
    assert force_error(pushed(1e-3, chatter), pushed(1e-3, none)) == pytest.approx(0.0, abs=1e-12)
    assert force_error(pushed(1e-3, chatter + 0.3), pushed(1e-3, none)) == pytest.approx(0.3)
    # half of a window is of a force that ends within it, and the whole run where that is shorter
    ended = np.where(np.arange(201) < 160, 0.0, 1.0)
    assert force_error(pushed(1e-3, ended), pushed(1e-3, none)) == pytest.approx(1.0)
    assert force_error(pushed(1e-3, ended[150:171]), pushed(1e-3, none[:21])) == pytest.approx(0.525)


def test_all_ticks_of_a_window_count() -> None:
    between = np.where(np.arange(201) % 20, 1.0, 0.0)  # nothing at the compared times
    assert force_error(pushed(1e-3, between), pushed(1e-3, np.zeros(201))) == pytest.approx(0.95)


def test_windows_are_the_same_of_both_runs() -> None:
    ramp = [5.0 * tick_s * np.arange(round(0.21 / tick_s) + 1) for tick_s in (1e-3, 1.5e-2, 3e-2)]
    fine, middle, coarse = map(pushed, (1e-3, 1.5e-2, 3e-2), ramp)
    for here, there in ((fine, coarse), (middle, fine), (coarse, middle)):
        assert force_error(here, there) == pytest.approx(0.0, abs=1e-12)


def test_with_an_arm_errors_are_of_second_order_in_the_tick() -> None:
    turn = {"axis": [0.0, 1.0, 0.0], "angle_rad": -0.2}
    changes = {
        "soft_robot": {"file": "hexagon_arm", "stack": {"units": 2}, "cable": []},
        "model.published": True,
        "start.pressure_Pa": 10e3,
        "start.cable_tension_N": [],
        "phase": [{"name": "turn", "duration_s": 0.4, "flange_turn": turn}],
        "solver.damping_per_s": 20.0,  # the errors are those of the motion, not of the film's vibrations
        "solver.dynamic_newton_iterations": 50,
        "solver.dynamic_tolerance_N": 1e-8,
    }
    scenario = load_scenario("ur5e_hexagon_arm", changes)
    coarse, middle, fine = (
        trace(load_scenario(scenario, {"clock.tick_s": tick_s}), build) for tick_s in (2e-3, 1e-3, 5e-4)
    )
    first, second = (error(coarse, middle), error(middle, fine))
    assert first.tip_error_m / second.tip_error_m == pytest.approx(4.0, abs=0.2)
    assert first.force_error_N / second.force_error_N == pytest.approx(4.0, abs=0.5)
    assert second.tip_error_m > 1e-8  # far above what the solver leaves


def error(here: Curve, there: Curve) -> Measured:
    return compared(Candidate("coarser", "time", {}), here, there)
