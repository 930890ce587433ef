"""Steps reuse a factorisation until it has cost as much as a new one, and jump with the flange."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cosim.base.frames import Pose
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import SoftBody
from cosim.soft.linear.factor import EXTRA_MAX
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.soft.bodies import HANGING, held, hexagon_arm, hung, no_load

STEP_S = 0.002
REUSING = NewtonOptions(reuse_max=6, start_tolerance_N=1e-6)


def with_beams() -> SoftBody:
    """Return an arm with a printed frame of twelve nodes and one of six."""
    body = hexagon_arm(2)
    rings = [
        BeamRings.from_shape(body.positions, body.rings[name][None], RectangularSection(width_m, 1e-3, 2e9))
        for name, width_m in (("unit_1.outer", 1e-3), ("unit_2.hole", 2e-3))
    ]
    return body.with_elements(*rings)


def test_a_factorisation_that_has_cost_as_much_as_a_new_one_is_dropped() -> None:
    arm = held(hexagon_arm(2))
    options = StepOptions("bdf2", 1e-9, newton=replace(REUSING, start_tolerance_N=1e-9))
    move, state = Stepper(arm.newton, arm.clamp, options), hung(arm).state
    due, dropped = False, 0
    for k in range(1, 60):
        acting = no_load(arm.body, pressure_Pa=(100.0 * k,))
        state, result = move.step(state, HANGING, acting, STEP_S)
        kept = arm.newton.factor.key
        assert kept is not None
        if due:
            assert result.factorisations > 0
        dropped += due
        due = kept.extra >= EXTRA_MAX
    assert dropped > 1


def jumped(iterations: int, tolerance_N: float, **loads: Any) -> tuple[SoftState, NewtonResult]:
    """Return the end of a step of 10 ms in which the flange jumps by 0.2 mm from rest, under gas."""
    arm, jump = held(with_beams()), np.array([2e-4, 1e-4, -5e-5])
    newton = replace(REUSING, start_tolerance_N=min(1e-6, tolerance_N))
    options = StepOptions("bdf2", tolerance_N, iterations, newton=newton)
    move, acting = (Stepper(arm.newton, arm.clamp, options), no_load(arm.body, pressure_Pa=(2e4,), **loads))
    state = hung(arm, pressure_Pa=(2e4,)).state
    for _ in range(2):
        state, _ = move.step(state, HANGING, acting, 0.01, HANGING)
    return move.step(state, Pose(HANGING.rotation, HANGING.translation + jump), acting, 0.01, HANGING)


def test_where_the_flange_jumps_the_film_begins_beside_it_and_is_solved() -> None:
    state, result = jumped(1, 1e-4)
    assert result.residual_N < 1e-4  # not just near enough, as after one new tangent in an ordinary step
    # from free flight, with held nodes alone where the flange has them, it takes 3 of them
    assert result.factorisations <= 2
    exact, _ = jumped(100, 1e-8)
    assert np.abs(exact.positions - state.positions).max() < 1e-7
