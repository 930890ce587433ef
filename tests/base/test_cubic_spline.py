"""Cubic splines are scipy's up to rounding, whatever their ends. The oracle takes long to load."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import interpolate

from cosim.base.cubic_spline import CubicSpline

RANDOM = np.random.default_rng(4)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 30])
@pytest.mark.parametrize("shape", [(), (6,), (2, 3)])
@pytest.mark.parametrize("ends", ["not a knot", "at rest", "with slopes"])
def test_values_and_derivatives_are_those_of_scipy(count: int, shape: tuple[int, ...], ends: str) -> None:
    x = np.cumsum(RANDOM.uniform(0.05, 1.0, count))
    y, slopes = RANDOM.normal(size=(count, *shape)), RANDOM.normal(size=(2, *shape))
    given: dict[str, Any] = {
        "not a knot": {},
        "at rest": {"slopes": (0.0, 0.0)},
        "with slopes": {"slopes": (slopes[0], slopes[1])},
    }[ends]
    kinds: dict[str, Any] = {
        "not a knot": "not-a-knot",
        "at rest": "clamped",
        "with slopes": ((1, slopes[0]), (1, slopes[1])),
    }
    mine, oracle = CubicSpline(x, y, **given), interpolate.CubicSpline(x, y, bc_type=kinds[ends])
    places = np.concatenate([x, RANDOM.uniform(x[0] - 0.3, x[-1] + 0.3, 40)])
    for order in range(4):
        expected = oracle(places, order)
        bound = 1e-11 * max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(mine(places, order), expected, rtol=0.0, atol=bound)
