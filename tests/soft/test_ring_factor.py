"""The factor that a ring of beams takes over from the last step in time, or point, changes no balance."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.soft.body.loads import Loads
from cosim.soft.elements.element import Instant
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from tests.soft.bodies import hexagon_arm
from tests.soft.test_beam_rings import NO_SLOTS, RADIUS_M, SECTION, circle, ring_of


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


def test_without_that_factor_a_ring_on_a_saddle_leaves_it() -> None:
    drawn, no_blocks = circle(3), np.zeros((0, 3, 3))
    beams = ring_of(drawn)
    remembered = beams.first_memory(drawn)
    beams.add(drawn, NO_SLOTS, np.zeros_like(drawn), no_blocks, Instant(remembered.copy(), remembered))
    with_it, without = (
        beams.add(0.99 * drawn, NO_SLOTS, np.zeros_like(drawn), no_blocks, Instant(memory, memory.copy()))
        for memory in (remembered, beams.fresh(remembered))
    )
    straight = 0.5 * SECTION.rigidities[0] * 0.01**2 * beams.lengths.sum()
    assert with_it == pytest.approx(straight, rel=1e-6), "the flat ring is in balance, though not stable"
    assert without < 0.6 * straight


class _Asked(FilmPotential):
    """Tells whether what its elements find is asked to be looked at anew."""

    asked = 0

    def fresh(self, memory: Array) -> Array:
        self.asked += 1
        return super().fresh(memory)


def test_a_static_solution_begins_without_factors_and_one_in_motion_with_them() -> None:
    body = hexagon_arm(1)
    system = _Asked(body)
    solver, x = NewtonSolver(system, np.zeros(body.nodes, dtype=bool)), body.positions
    ones, none = np.ones(body.nodes), NewtonOptions(iterations_max=0)
    statics = (None, Inertia(ones, x), Inertia(ones, x, 1e-3, closely=True))
    for inertia in (*statics, Inertia(ones, x, 1e-3)):
        solver.solve(x, body.first_memory(), Loads(), none, inertia)
    assert system.asked == len(statics)
