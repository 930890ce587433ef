"""How far a soft arm swings on an accelerated flange, against the oscillator's closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cosim.plan.swing import FlangeAcceleration

STEP_S = 0.002
RATE_rad_s = 10.0
ALONG = np.array([0.0, 0.6, -0.8])


def swing_of(values: list[float]) -> tuple[float, float]:
    """Return progress and size [m/s^2] of the swing that accelerations along a line make."""
    fractions = np.linspace(0.0, 1.0, len(values))  # of the ramp
    found = FlangeAcceleration(fractions, np.outer(values, ALONG), STEP_S)
    place, swing = found.swing(RATE_rad_s)
    np.testing.assert_allclose(np.cross(swing, ALONG), 0.0, atol=1e-12)
    return place, float(swing @ ALONG)


def test_a_slow_acceleration_is_followed() -> None:
    count = round(40.0 * 2.0 * math.pi / RATE_rad_s / STEP_S)  # 40 periods
    place, size = swing_of((3.0 * np.sin(np.linspace(0.0, math.pi, count)) ** 2).tolist())
    assert size == pytest.approx(3.0, rel=2e-3)
    assert place == pytest.approx(0.5, abs=0.01)


def test_a_sudden_acceleration_is_overshot_by_as_much() -> None:
    _, size = swing_of([3.0] * round(2.0 * math.pi / RATE_rad_s / STEP_S))
    assert size == pytest.approx(6.0, rel=1e-4)


def test_a_leap_in_speed_swings_the_arm_after_it() -> None:
    place, size = swing_of([3.0 / STEP_S])  # 3 m/s, at once
    assert size == pytest.approx(3.0 * RATE_rad_s, rel=1e-3)
    assert place == 0.0
