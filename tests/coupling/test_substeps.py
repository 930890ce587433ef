"""Soft steps cut into pieces by their estimated error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.coupling.soft_sides.lumped_arm import SoftArm, pieces_after, pose_within, step_error
from cosim.plan.motion import progress
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Integrator, SoftState, StepOptions
from tests.soft.bodies import HANGING, PRESSURE_Pa, hexagon_arm, no_load

TICK_S, DURATION_S = 0.02, 0.24
EXACT = StepOptions(
    tolerance_N=1e-8, iterations=50, residual_bound_N=0.0, newton=NewtonOptions(1e-8, start_tolerance_N=1e-9),
    damping_per_s=20.0,
)  # fmt: skip


def resting(dynamics: StepOptions) -> SoftArm:
    """Return an inflated arm of two units at rest."""
    arm = SoftArm(hexagon_arm(2), HANGING, NewtonOptions(), dynamics)
    arm.settle(arm.start(HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))))
    return arm


def swung(time_s: float) -> Pose:
    """Return a flange that swings up smoothly, 0.6 rad in a quarter of a second."""
    turn = 0.6 * progress("smooth", time_s, DURATION_S).value
    return Pose(rotation_from_vector(np.array([0.0, turn, 0.0])) @ HANGING.rotation, HANGING.translation)


def tips(arm: SoftArm, tick_s: float) -> Array:
    """Return the tip (k, 3) [m] every 20 ms of the swing."""
    loads, found = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)), []
    for k in range(1, round(DURATION_S / tick_s) + 1):
        arm.advance(swung(k * tick_s), loads, tick_s)
        if k % round(TICK_S / tick_s) == 0:
            found.append(arm.body.tip_position(arm.state.positions))
    return np.array(found)


@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("bdf2", 2)])
def test_the_estimate_goes_with_the_step_like_the_error(integrator: Integrator, order: int) -> None:
    estimates = []
    for step in (2e-3, 1e-3):
        arm = resting(replace(EXACT, integrator=integrator))
        loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
        for k in range(1, round(0.06 / step) + 1):
            before = arm.state
            arm.advance(swung(k * step), loads, step)
        estimates.append(step_error(integrator, before, arm.state, step))
    assert estimates[0] / estimates[1] == pytest.approx(2.0 ** (order + 1), rel=0.25)


def test_the_estimate_of_euler_is_the_error_of_a_given_acceleration() -> None:
    # the base follows x = a t^2 / 2 exactly, and carries the estimate: half the distance from free flight
    arm = resting(EXACT)
    acceleration, step = np.array([3.0, 0.0, 0.0]), 1e-3
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    for k in range(1, 4):
        before = arm.state
        shifted = HANGING.translation + 0.5 * acceleration * (k * step) ** 2
        arm.advance(Pose(HANGING.rotation, shifted), loads, step)
    base = arm.body.base
    away = arm.state.positions - before.positions - step * before.velocities
    assert np.abs(away[base]).max() == pytest.approx(3.0 * step**2, rel=1e-6)
    assert step_error("implicit_euler", before, arm.state, step) >= 0.5 * 3.0 * step**2 * 0.99


def test_the_estimate_is_the_error_of_a_step_where_the_next_derivative_is_constant() -> None:
    # one free component under a known force; velocity and place before the step are exact
    h, pull, rate = 0.02, 3.0, 70.0

    def state(x: float, v: float, earlier: tuple[Array, Array] | None = None) -> SoftState:
        return SoftState(np.array([[x, 0.0, 0.0]]), np.array([[v, 0.0, 0.0]]), np.zeros(0), earlier)

    v1 = pull * h
    estimate = step_error("implicit_euler", state(0.0, 0.0), state(h * v1, v1), h)
    assert estimate == pytest.approx(h * v1 - 0.5 * pull * h**2)
    # x = rate t^3 / 6, from t = 2 h to 3 h
    (xa, va), (xb, vb) = ((rate * (k * h) ** 3 / 6.0, 0.5 * rate * (k * h) ** 2) for k in (1, 2))
    span = 2.0 * h / 3.0
    vc = (4.0 * vb - va) / 3.0 + span * rate * 3.0 * h
    xc = (4.0 * xb - xa) / 3.0 + span * vc
    earlier = state(xa, va)
    before = state(xb, vb, (earlier.positions, earlier.velocities))
    estimate = step_error("bdf2", before, state(xc, vc), h)
    assert estimate == pytest.approx(abs(xc - rate * (3.0 * h) ** 3 / 6.0), rel=1e-9)


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_pieces_bring_a_long_tick_near_short_ones(integrator: Integrator) -> None:
    options = replace(EXACT, integrator=integrator)
    truth = tips(resting(replace(options, integrator="bdf2")), 1e-3)
    plain, cut = resting(options), resting(replace(options, substep_error_m=2e-5))
    errors = [float(np.sqrt(((tips(arm, TICK_S) - truth) ** 2).mean())) for arm in (plain, cut)]
    # what is left is the way of the flange within a tick, which is known at its ends only
    assert errors[1] < 0.5 * errors[0]


def test_without_a_bound_nothing_changes_and_a_loose_one_cuts_nothing() -> None:
    runs = [tips(resting(replace(EXACT, substep_error_m=bound)), TICK_S) for bound in (None, 1.0)]
    assert (runs[0] == runs[1]).all()


def test_a_saved_state_goes_on_in_the_same_pieces() -> None:
    options = replace(EXACT, integrator="bdf2", substep_error_m=2e-5)
    arm, other = resting(options), resting(options)
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    for k in range(1, 5):
        arm.advance(swung(k * TICK_S), loads, TICK_S)
    saved = arm.save_state()
    assert saved.pieces > 1
    other.restore_state(saved)
    for each in (arm, other):
        for k in range(5, 8):
            each.advance(swung(k * TICK_S), loads, TICK_S)
    assert (arm.state.positions == other.state.positions).all()


def test_how_many_pieces() -> None:
    assert pieces_after(1, 4e-5, 1e-5, 1) == 3  # 1.2 sqrt(4), rounded up
    assert pieces_after(2, 1.01e-5, 1e-5, 1) == 3
    assert pieces_after(4, 1.0, 1e-5, 1) == 16
    assert pieces_after(4, 0.9e-5, 1e-5, 1) == 4
    assert pieces_after(4, 1e-7, 1e-5, 1) == 2
    assert pieces_after(1, 0.0, 1e-5, 2) == 1
    # fewer only where twice as long pieces would still stay below a half of the bound
    assert [pieces_after(4, error, 1e-5, 1) for error in (1.3e-6, 1.2e-6)] == [4, 2]
    assert [pieces_after(4, error, 1e-5, 2) for error in (6.3e-7, 6.2e-7)] == [4, 2]


def test_the_flange_goes_on_a_parabola_within_a_tick() -> None:
    spin, push = np.array([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -0.5])

    def at(time: float) -> Pose:
        # constant acceleration, about a fixed axis
        angle = 0.4 * time + 0.3 * time**2
        turn = rotation_from_vector(angle * spin)
        return Pose(turn @ HANGING.rotation, HANGING.translation + (time + 0.5 * time**2) * push)

    for share in (0.2, 0.5, 0.9):
        found, expected = pose_within(at(0.5), at(1.0), at(1.5), share), at(1.0 + 0.5 * share)
        assert found.translation == pytest.approx(expected.translation, abs=1e-12)
        assert found.rotation == pytest.approx(expected.rotation, abs=1e-12)
    straight = pose_within(None, at(1.0), at(1.5), 0.5).translation
    assert straight == pytest.approx(0.5 * (at(1.0).translation + at(1.5).translation))
