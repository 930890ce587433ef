"""At the ends of what may be asked for a run ends well or fails by name; same ranges as the atlas."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from benchmarks.atlas.extremes import RANGES, Extreme, judged, probe
from benchmarks.atlas.on_arm import POSES, ArmExtreme, overrides, probe_arm
from benchmarks.stability import maps, unstable_reference
from cosim.base.frames import Wrench
from cosim.config.loading import load_scenario
from cosim.errors import ConvergenceError
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.newton_options import Outcome


def fixed(examples: int) -> settings:
    """Return settings under which every run of the tests draws the same examples."""
    return settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def number(name: str) -> st.SearchStrategy[float]:
    """Return numbers of a range: even in their logarithm where the range spans decades."""
    low, high = RANGES[name]
    if low > 0.0:
        return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: float(10.0**exponent))
    return st.floats(low, high)


EXTREMES = st.builds(
    Extreme,
    **{name: st.one_of(st.just(getattr(Extreme(), name)), number(name)) for name in RANGES},
    units=st.integers(1, 2),
    flipped=st.sampled_from([0, 0, 0, 1, 7, 84]),
    cable=st.sampled_from(["ramp", "jerk", "cut"]),
    law=st.sampled_from(["plain", "plain", "tension_field", "edge_strain"]),
    integrator=st.sampled_from(["implicit_euler", "bdf2"]),
    closed=st.sampled_from([True, True, False]),
    statics=st.sampled_from([False, False, True]),
    ticks=st.just(20),
)
ARM_EXTREMES = st.builds(
    ArmExtreme,
    tick_s=number("tick_s"),
    pressure_Pa=number("pressure_Pa"),
    mass_ratio=st.floats(-4.0, 1.0).map(lambda exponent: float(10.0**exponent)),
    pose=st.sampled_from(sorted(POSES)),
    step_m=st.one_of(st.just(0.0), st.floats(1e-3, 0.5)),
    integrator=st.sampled_from(["implicit_euler", "bdf2"]),
    short=st.just(True),
)


@fixed(8)
@given(EXTREMES)
@example(Extreme())
@example(Extreme(tick_s=0.1, jump_m=0.5, spin_rad_s=20.0))
@example(Extreme(closed=False, law="tension_field", node_mass_kg=1e-7, gravity_m_s2=0.0, pressure_Pa=0.0))
@example(Extreme(sliver=1e-12))
@example(Extreme(tension_N=1e3, cable="cut"))
def test_a_soft_arm_runs_or_fails_by_name(extreme: Extreme) -> None:
    verdict = probe(extreme)
    assert verdict.kind != "unnamed", verdict.name
    assert (verdict.name == "") == (verdict.kind in ("stable", "slow"))


@fixed(4)
@given(ARM_EXTREMES)
@example(ArmExtreme(short=True, tick_s=0.1, mass_ratio=10.0))
def test_a_soft_arm_on_a_robot_runs_or_fails_by_name(extreme: ArmExtreme) -> None:
    verdict = probe_arm(extreme)
    assert verdict.kind != "unnamed", verdict.name


@pytest.mark.parametrize("tick_s", [1e-4, 2e-3, 2e-2])
@pytest.mark.parametrize("pressure_Pa", [0.0, 100e3])
def test_corners_of_the_stable_region(tick_s: float, pressure_Pa: float) -> None:
    verdict = probe(Extreme(tick_s=tick_s, pressure_Pa=pressure_Pa, ticks=30))
    assert verdict.kind == "stable", verdict


def fails(error: BaseException) -> Any:
    def run() -> float:
        raise error

    return run


def test_verdicts() -> None:
    newton = ConvergenceError(f"no: {Outcome.NO_DESCENT.value}", 1.0, 1)
    assert judged(lambda: 3.0, lambda: True).kind == "stable"
    assert judged(lambda: 300.0, lambda: True).kind == "slow"
    named = judged(fails(newton), lambda: True)
    assert (named.kind, named.name) == ("named", "ConvergenceError NO_DESCENT")
    assert judged(fails(newton), lambda: False).kind == "unnamed"  # the state before it is lost
    assert judged(fails(RuntimeError("singular")), lambda: True).kind == "unnamed"

    def warns() -> float:
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        return 1.0

    assert judged(warns, lambda: True).kind == "unnamed"


def test_a_number_that_is_not_finite_does_not_go_unseen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Clamp, "wrench", lambda *_: Wrench(np.full(3, np.nan), np.zeros(3)))
    for extreme in (Extreme(units=1), Extreme(units=1, statics=True), ArmExtreme(short=True)):
        verdict = probe(extreme) if isinstance(extreme, Extreme) else probe_arm(extreme)
        assert verdict.kind == "unnamed", extreme


def test_the_atlas_is_large_and_its_scenarios_load() -> None:
    charts = maps()
    assert sum(len(chart.x[1]) * len(chart.y[1]) for chart in charts) >= 2000
    for chart in charts:
        assert hasattr(chart.base, chart.x[0])
        assert hasattr(chart.base, chart.y[0])
    heavy = ArmExtreme(short=True, mass_ratio=10.0, object_kg=100.0)
    assert load_scenario("ur5e_hexagon_arm", overrides(heavy)).objects[0].mass_kg == 100.0
    assert not load_scenario("ur5e_hexagon_arm", overrides(replace(heavy, object_kg=None))).objects


def test_the_required_region_is_tested() -> None:
    good = {"tick_s": 1e-3, "pressure_Pa": 30e3, "kind": "stable"}
    outside = {"tick_s": 0.1, "pressure_Pa": 30e3, "kind": "named"}
    bad = {"tick_s": 2e-2, "pressure_Pa": 100e3, "kind": "named"}
    assert unstable_reference([good, outside, bad]) == [bad]


@pytest.mark.parametrize("pressure_Pa", [20e3, 30e3])
def test_a_hurried_turn_is_not_slow_at_20_ms(pressure_Pa: float) -> None:
    # from free flight alone Newton's method took 25 to 40 iterations a tick, and 12 are slow
    found = probe_arm(ArmExtreme(tick_s=0.02, pressure_Pa=pressure_Pa))
    assert found.kind == "stable"
