"""The factor that a ring of beams takes over from the last step in time changes no balance."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.soft.elements.element import Instant
from tests.soft.test_beam_rings import NO_SLOTS, RADIUS_M, circle, ring_of


@pytest.mark.parametrize("further", [1e-5, 1e-3, 2e-2], ids=["serves", "serves badly", "does not serve"])
def test_a_factor_that_a_step_takes_over_leaves_the_balance_as_it_is(further: float) -> None:
    drawn, random = circle(8), np.random.default_rng(2)
    beams, y = ring_of(drawn), 1.01 * drawn
    remembered, no_blocks = beams.first_memory(drawn), np.zeros((0, 3, 3))
    beams.add(y, NO_SLOTS, np.zeros_like(y), no_blocks, Instant(remembered.copy(), remembered, 1e-3))
    assert remembered[32:].any(), "the factor"
    y = y + further * RADIUS_M * random.normal(size=y.shape)
    found = []
    for step_s in (1e-3, np.inf):  # with it, and without
        tracked, gradient = remembered.copy(), np.zeros_like(y)
        energy = beams.add(y, NO_SLOTS, gradient, no_blocks, Instant(remembered, tracked, step_s))
        found.append((energy, gradient, tracked[:32]))
    (energy, gradient, turns), (other, expected, others) = found
    assert energy == pytest.approx(other, rel=1e-10)
    assert turns == pytest.approx(others, abs=1e-9)
    assert gradient == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())
