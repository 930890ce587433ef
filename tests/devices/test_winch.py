"""Winch: resolution of steps, speed limit, stall, lost steps."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from cosim.config.schema.devices import WinchTable
from cosim.devices.winch import WinchState

TICK_s = 2e-3
STIFFNESS = 5e3
# NEMA 17, 16 microsteps, gear 10:1, drum of 10 mm: 1.96 um a step, 22 mm/s, 400 N
WINCH = WinchTable("fine", ("a",), math.pi / 1600.0, 0.01, 11200.0, 0.4, 10.0)
COARSE = WinchTable("coarse", ("a",), math.pi / 100.0, 0.01, 900.0, 0.05)


def wind(
    winch: WinchTable, wanted_m: float, ticks: int, spring_N_m: float = 0.0, state: WinchState | None = None
) -> list[WinchState]:
    """Return the states of a winch whose cable pulls on a spring, taut at 0.3 m."""
    state = WinchState(0.3) if state is None else state
    states = [state]
    for _ in range(ticks):
        tension = max(spring_N_m * (0.3 - state.length_m(winch)), 0.0)
        # cable and spring are one: the spring's end is fixed
        state = state.advanced(winch, wanted_m, tension, spring_N_m or STIFFNESS, TICK_s)
        states.append(state)
    return states


def test_figures_of_a_winch() -> None:
    assert WINCH.step_m == pytest.approx(1.9635e-6, rel=1e-4)
    assert WINCH.speed_m_s == pytest.approx(22.0e-3, rel=1e-3)
    assert WINCH.stall_force_N == pytest.approx(400.0)


@pytest.mark.parametrize("wanted", [0.29, 0.3104321])
def test_lengths_are_whole_steps(wanted: float) -> None:
    last = wind(COARSE, wanted, 100)[-1]
    assert abs(last.length_m(COARSE) - wanted) <= 0.5 * COARSE.step_m * (1.0 + 1e-9)
    assert last.commanded == round((0.3 - wanted) / COARSE.step_m)
    # and then it stands
    assert last.advanced(COARSE, wanted, 0.0, STIFFNESS, TICK_s).commanded == last.commanded


@pytest.mark.parametrize("wanted", [1e308, -1e308])
def test_a_length_beyond_all_cables_is_wound_towards_at_its_speed(wanted: float) -> None:
    last = wind(COARSE, wanted, 100)[-1]
    assert abs(last.commanded) == pytest.approx(COARSE.step_rate_per_s * 100 * TICK_s, abs=1)


def test_speed_is_limited_also_below_a_step_per_tick() -> None:
    slow = replace(COARSE, step_rate_per_s=130.0)  # 0.26 steps a tick
    states = wind(slow, 0.2, 1000)
    assert states[-1].commanded == pytest.approx(130.0 * 2.0, abs=1)
    assert max(b.commanded - a.commanded for a, b in pairwise(states)) == 1
    # what was not stepped while it stood is not made up for
    idle = wind(slow, 0.3, 1000)[-1]
    assert wind(slow, 0.2, 10, state=idle)[-1].commanded <= 4


def test_against_a_spring_the_winch_stalls_at_its_force_and_loses_steps() -> None:
    states = wind(COARSE, 0.25, 400, spring_N_m=1000.0)
    pulls = [1000.0 * (0.3 - state.length_m(COARSE)) for state in states]
    last, held = states[-1], pulls[-1]
    assert max(pulls) <= COARSE.stall_force_N
    assert COARSE.stall_force_N == pytest.approx(5.0)
    assert COARSE.stall_force_N - 1000.0 * COARSE.step_m <= held <= COARSE.stall_force_N
    # the driver believes that it is there
    assert last.commanded == round(0.05 / COARSE.step_m)
    assert last.lost == last.commanded - math.floor(5.0 / (1000.0 * COARSE.step_m))
    # so it comes back too long, by the steps that it lost
    back = wind(COARSE, 0.3, 400, spring_N_m=1000.0, state=last)[-1]
    assert back.length_m(COARSE) - 0.3 == pytest.approx(last.lost * COARSE.step_m)


def test_a_load_beyond_stall_drags_the_drum_back() -> None:
    begin = WinchState(0.3)
    after = begin.advanced(COARSE, 0.3, 5.0 + 2.5 * STIFFNESS * COARSE.step_m, STIFFNESS, TICK_s)
    assert (after.commanded, after.lost) == (0, 3)
    assert begin.advanced(COARSE, 0.3, 4.99, STIFFNESS, TICK_s).lost == 0


def test_paying_out_is_not_hindered_by_the_tension() -> None:
    after = WinchState(0.3).advanced(COARSE, 0.35, 4.99, STIFFNESS, TICK_s)
    assert (after.commanded, after.lost) == (-1, 0)
