"""The start for cube roots: near the root over all magnitudes."""

from __future__ import annotations

import numpy as np

from cosim.soft.elements.wrinkling import rough_cube_root
from tests.compiled import compiled

root = compiled(rough_cube_root)


def test_the_start_is_within_five_percent_of_the_root() -> None:
    values = 10.0 ** np.random.default_rng(3).uniform(-30.0, 300.0, size=2000)
    found = np.array([root(float(value)) for value in values])
    assert np.abs(found / np.cbrt(values) - 1.0).max() < 0.05
