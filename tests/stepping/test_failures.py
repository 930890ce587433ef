"""A run that fails says where: phase, tick or increment, pressure, tension, and node."""

from __future__ import annotations

from typing import Any

import pytest

import cosim
from cosim.errors import ConvergenceError
from cosim.stepping.stepped_run import whereabouts

INFLATE: dict[str, Any] = {"name": "inflate", "duration_s": 0.2, "increments": 8, "pressure_Pa": 5e3}


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        (
            "dynamic",
            r"phase 'inflate', tick 1 \(0\.01 s\), 0 kPa.*: even in steps of 0\.312 ms: the soft step "
            r"did not converge: .*; residual \S+ N after \d+ iterations, the largest at "
            r"node \d+ (of|near) (unit_\d|tip)",
        ),
        ("quasistatic", r"phase 'inflate', increment 1 of 8, 0 kPa.*: no equilibrium found: "),
    ],
)
def test_a_failure_names_phase_and_step(mode: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = {"clock.tick_s": 0.01, "mode": mode, "phase": [INFLATE]}
    run = cosim.Simulation("three_unit_inflation", overrides=steps)
    bounds = {"residual_tolerance_N": 1e-15, "dynamic_tolerance_N": 1e-15}
    sudden = {"phase.inflate.ramp": "step", "phase.inflate.pressure_Pa": 9e4}
    monkeypatch.setattr("cosim.build.options.EQUILIBRIUM_ITERATIONS_MAX", 1)
    hopeless = run.branch({f"solver.{key}": value for key, value in bounds.items()} | sudden)
    with pytest.raises(ConvergenceError, match=message) as caught:
        hopeless.step(3)
    assert "tick_s" not in str(caught.value)
    assert "shorter tick" not in str(caught.value)


def test_pressures_and_tensions_are_those_that_matter() -> None:
    found = whereabouts("close", "tick 3 (0.006 s)", (2e4, 3e4), (0.0, 2.5, 1.0), ("a", "b", "c"))
    assert found == "phase 'close', tick 3 (0.006 s), 20 to 30 kPa, cable b at 2.5 N"
    assert whereabouts("p", "increment 1 of 2", (5e3,), (0.0,), ("a",)) == (
        "phase 'p', increment 1 of 2, 5 kPa, cables slack"
    )
