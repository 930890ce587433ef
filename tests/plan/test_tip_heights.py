"""Tip heights from their benchmark, a few of them, and a plan whose search ended beside its motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.tip_heights import HANGING, Bench, Design, draws, measure
from cosim.config.schema.phase import TipTargetTable
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import UnreachableError
from cosim.plan.tip_targets import reach
from cosim.soft.solve import tip_target as search
from cosim.soft.solve.state import Equilibrium

SMALL = Design(6, 5, 0.95, 0.05, 0.11e-3, 30e3, 0.3 * np.pi)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(SMALL)


def test_heights_of_an_arm_are_all_found_and_held() -> None:
    for _, height in measure(1, 5):
        assert height.held_mm is not None, height.message
        assert height.held_mm < 0.02
        assert height.iterations <= 10


def test_heights_are_drawn_as_the_benchmark_says() -> None:
    tensions = draws(np.random.default_rng(0))
    (a, b), (c, d) = next(tensions), next(tensions)
    assert a == b == c != d
    assert all(2.0 <= tension <= 15.0 for tension in (a, d))


def test_a_height_that_is_too_high_is_refused_with_the_heights_reached(bench: Bench) -> None:
    with pytest.raises(UnreachableError) as caught:
        bench.soft.find_tensions(bench.slack, search.TipTarget(height=0.75))
    message, nearest = str(caught.value), caught.value.closest.equilibrium
    slack = f"{bench.height(bench.slack):.4f} m at [0.0, 0.0] N"
    assert f"pulling all cables from [0.0, 0.0] N to [100.0, 100.0] N: from {slack}" in message
    assert bench.height(nearest) > bench.height(bench.pulled((20.0, 20.0), 10))
    assert "degrees" not in message  # none was asked for


def test_a_search_that_ended_where_the_motion_does_not_lead_is_repeated(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    height, calls = bench.height(bench.slack) + 0.01, 0
    find = FilmRobot.find_tensions

    def astray(soft: FilmRobot, here: Equilibrium, target: search.TipTarget) -> Equilibrium:
        nonlocal calls
        calls += 1
        found = find(soft, here, target)
        return found if calls > 1 else replace(found, loads=replace(found.loads, cable_tension_N=(1.0, 0.5)))

    monkeypatch.setattr(FilmRobot, "find_tensions", astray)
    target = TipTargetTable(height_m=height, reach_with="cables")
    way, end = reach(bench.soft, bench.slack, bench.slack.loads, target)
    assert bench.height(end) == pytest.approx(height, abs=2e-5)
    assert calls == 2
    assert way.end.translation == pytest.approx(HANGING.translation)
