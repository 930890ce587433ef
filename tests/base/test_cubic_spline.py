"""Own splines against those of scipy, and against a cubic, which they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline as Known

from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array

ROUNDING = 1e-13  # of values of order one, after up to 40 equations
RNG = np.random.default_rng(5)


def through(count: int, *shape: int) -> tuple[Array, Array]:
    """Return uneven places and values."""
    return np.cumsum(RNG.uniform(0.5, 1.5, count)), RNG.normal(size=(count, *shape))


@pytest.mark.parametrize("count", [2, 3, 4, 5, 40])
@pytest.mark.parametrize("shape", [(), (1,), (6,), (2, 3)])
@pytest.mark.parametrize("given", ["none", "slopes", "rest"])
def test_splines_are_those_of_scipy(count: int, shape: tuple[int, ...], given: str) -> None:
    places, values = through(count, *shape)
    slopes = RNG.normal(size=(2, *shape)) if given == "slopes" else np.zeros((2, *shape))
    own = CubicSpline(places, values, None if given == "none" else slopes)
    ends: Any = {"none": "not-a-knot", "slopes": ((1, slopes[0]), (1, slopes[1])), "rest": "clamped"}
    known = Known(places, values, bc_type=ends[given])
    around = np.linspace(places[0] - 0.3, places[-1] + 0.3, 57)
    asked = (around, around.reshape(3, 19), float(around[20]), places, float(places[0]), float(places[-1]))
    for where in asked:
        for order in range(3):
            found, wanted = own(where, order), np.asarray(known(where, order))
            assert found.shape == wanted.shape
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=ROUNDING * max(1.0, abs(wanted).max()))


def test_a_cubic_is_its_own_spline() -> None:
    places, _ = through(7)
    spline = CubicSpline(places, 2.0 - places + 0.5 * places**2 - 0.25 * places**3)
    where = np.linspace(places[0], places[-1], 50)
    for order, wanted in enumerate(
        (2.0 - where + 0.5 * where**2 - 0.25 * where**3, -1.0 + where - 0.75 * where**2, 1.0 - 1.5 * where)
    ):
        np.testing.assert_allclose(spline(where, order), wanted, rtol=0.0, atol=1e-11)
