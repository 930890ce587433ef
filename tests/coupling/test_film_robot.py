"""The soft side on its own: replies to flange motions, sub-steps, what a failure leaves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, Twist, rotation_from_vector, vector_from_rotation
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.robots.stability_ratio import exchange_gain
from cosim.errors import ConvergenceError
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.soft.bodies import HANGING, PRESSURE_Pa, hexagon_arm, no_load

STEP_S = 0.002
TIGHT = StepOptions(
    tolerance_N=1e-8, iterations=50, residual_bound_N=0.0, newton=NewtonOptions(1e-8, start_tolerance_N=1e-9)
)
SHIFT = np.array([2.0, 1.0, -3.0])  # half the flange's acceleration [m/s^2]
TURN = np.array([3.0, -4.0, 5.0])  # the same of its rotation [rad/s^2]


def hanging_arm(units: int = 3, dynamics: StepOptions = TIGHT) -> FilmRobot:
    """Return an inflated arm at rest."""
    arm = FilmRobot(hexagon_arm(units), HANGING, NewtonOptions(), dynamics)
    solver = arm.equilibrium_solver
    hung = solver.solve(arm.state, HANGING, no_load(arm.body))
    arm.commit(solver.follow(hung, HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))))
    return arm


def moving(time_s: float, turn: Array = TURN) -> Pose:
    """Return a flange that accelerates and turns about one axis."""
    return Pose(
        rotation_from_vector(turn * time_s**2) @ HANGING.rotation, HANGING.translation + SHIFT * time_s**2
    )


def power_W(arm: FilmRobot) -> float:
    """Return the power taken in at the held nodes in the last step, sum of reaction times velocity."""
    return float((arm.reaction * arm.state.velocities[arm.clamp.nodes]).sum())


def test_at_rest_the_reply_is_the_weight() -> None:
    arm = hanging_arm()
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    for _ in range(5):
        reply = arm.advance(HANGING, loads, STEP_S)
    weight = 9.81 * arm.body.mass_kg
    assert reply.wrench.force == pytest.approx([0.0, 0.0, -weight], abs=1e-6 * weight)
    assert reply.wrench.torque == pytest.approx(np.zeros(3), abs=1e-6)
    assert power_W(arm) == pytest.approx(0.0, abs=1e-8)


def test_what_newtons_method_does_not_reach_a_body_slides_to() -> None:
    arm, loads = hanging_arm(), no_load(hexagon_arm(3), pressure_Pa=(PRESSURE_Pa,))
    arm = FilmRobot(arm.body, HANGING, NewtonOptions(iterations_max=8), TIGHT)
    with pytest.raises(ConvergenceError):
        arm.solve(arm.state, HANGING, loads)
    found = arm.find_rest(arm.state, HANGING, loads, 500)
    assert found.residual_N < 1e-6
    assert found.negative_pivots == 0
    assert found.iterations > 8
    with pytest.raises(ConvergenceError, match="bound of 30 "):
        arm.find_rest(arm.state, HANGING, loads, 30)
    assert arm.effort.iterations_max == NewtonOptions().search_iterations_max


def test_a_slide_that_gets_no_nearer_to_rest_is_given_up() -> None:
    arm, loads = hanging_arm(), no_load(hexagon_arm(3), pressure_Pa=(PRESSURE_Pa,))
    arm = FilmRobot(arm.body, HANGING, NewtonOptions(iterations_max=8), TIGHT)
    found = arm.find_rest(arm.state, HANGING, loads, 500, 100)
    assert arm.effort.patience == math.inf
    impatient = FilmRobot(arm.body, HANGING, NewtonOptions(iterations_max=8), TIGHT)
    with pytest.raises(ConvergenceError):
        impatient.find_rest(impatient.state, HANGING, loads, 500, 1)
    assert impatient.effort.work < arm.effort.work
    assert found.iterations <= arm.effort.work  # those of tangents that were indefinite on top


def test_a_start_that_no_shift_makes_definite_is_left_at_once() -> None:
    arm = hanging_arm()
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    crumpled = arm.state.positions + np.random.default_rng(1).uniform(-0.01, 0.01, arm.state.positions.shape)
    stiff = NewtonOptions(shift_max_N_m=1.0)
    arm = FilmRobot(arm.body, HANGING, stiff, TIGHT)
    with pytest.raises(ConvergenceError, match="no shift up to its bound"):
        arm.find_rest(arm.state_at_rest(crumpled, HANGING), HANGING, loads, 500)
    # four solutions try three shifts each, and the tangent as it is
    assert 4 <= arm.effort.work <= 20


def test_a_residual_that_rounding_keeps_from_falling_takes_no_new_tangent() -> None:
    arm = hanging_arm()
    solver, loads = arm.equilibrium_solver.solver, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    options = NewtonOptions(tolerance_N=1e-4, start_tolerance_N=1e-15, reuse_max=12)
    rest = solver.solve(arm.state.positions, arm.state.memory, loads, options)
    for _ in range(3):
        again = solver.solve(rest.positions, rest.memory, loads, options)
        assert again.converged
        assert again.factorisations == 0


def test_reaction_changes_momentum_and_angular_momentum() -> None:
    # Newton and Euler for the whole body: what the flange supplies, plus weight, is d(momentum)/dt
    arm = hanging_arm()
    mass, loads = arm.body.node_mass, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    weight, largest = mass[:, None] * np.array(loads.gravity), 0.0
    for k in range(1, 21):
        before, flange = arm.state.velocities, moving(k * STEP_S)
        reply = arm.advance(flange, loads, STEP_S)
        gained = mass[:, None] * (arm.state.velocities - before) / STEP_S
        # residuals of 1e-8 N on 132 nodes
        assert -reply.wrench.force + weight.sum(axis=0) == pytest.approx(gained.sum(axis=0), abs=2e-6)
        offset = arm.state.positions - flange.translation
        supplied = -reply.wrench.torque + np.cross(offset, weight).sum(axis=0)
        assert supplied == pytest.approx(np.cross(offset, gained).sum(axis=0), abs=2e-7)
        largest = max(largest, float(np.linalg.norm(gained.sum(axis=0))))
    assert largest > 0.5  # some 7 m/s^2 on 0.27 kg


@pytest.mark.parametrize(("turn", "relative"), [(np.zeros(3), 1e-9), (TURN, 0.01)])
def test_power_at_the_held_nodes_is_minus_wrench_times_twist(turn: Array, relative: float) -> None:
    # Held nodes move with the flange, at the mean velocity of the step: exactly so if it only shifts. If it
    # turns by 1e-3 rad in a step, chords are shorter than arcs, and the films squeeze the base ring hard.
    arm, loads, powers, errors = hanging_arm(), no_load(hexagon_arm(3), pressure_Pa=(PRESSURE_Pa,)), [], []
    for k in range(1, 21):
        before, after = moving((k - 1) * STEP_S, turn), moving(k * STEP_S, turn)
        reply = arm.advance(after, loads, STEP_S)
        spin = vector_from_rotation(after.rotation @ before.rotation.T) / STEP_S
        twist = Twist((after.translation - before.translation) / STEP_S, spin)
        powers.append(power_W(arm))
        errors.append(powers[-1] + reply.wrench.power(twist))
    assert max(powers) > 0.05
    assert np.abs(errors).max() < relative * np.abs(powers).max()


def test_held_nodes_follow_the_flange_exactly() -> None:
    arm = hanging_arm()
    rim = arm.body.rings["unit_1.outer"]
    hold = np.zeros((arm.body.nodes, 3), dtype=bool)
    hold[rim] = True
    arm.hold_components(hold, HANGING)
    local = HANGING.inverse().apply(arm.state.positions)
    arm.advance(moving(0.03), no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)), STEP_S)
    held = np.concatenate([arm.body.base, rim])
    assert moving(0.03).inverse().apply(arm.state.positions)[held] == pytest.approx(local[held], abs=1e-14)
    assert len(arm.reaction) == len(held)


def test_a_step_that_fails_is_taken_in_halves(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[float] = []
    step = Stepper.step

    def short_ones_only(
        self: Stepper, state: Any, flange: Pose, loads: Any, step_s: float, *rest: Any
    ) -> Any:
        if step_s > 0.3 * STEP_S:
            raise ConvergenceError("too long", 1.0, 10)
        taken.append(step_s)
        return step(self, state, flange, loads, step_s, *rest)

    arm, flange = hanging_arm(), moving(0.02)
    first, begin = moving(0.01), no_load(arm.body, pressure_Pa=(0.97 * PRESSURE_Pa,))
    loads = no_load(arm.body, pressure_Pa=(0.9 * PRESSURE_Pa,))
    arm.advance(first, begin, STEP_S)
    with monkeypatch.context() as patch:
        patch.setattr(Stepper, "step", short_ones_only)
        reply = arm.advance(flange, loads, STEP_S)
    assert taken == [0.25 * STEP_S] * 4
    assert reply.iterations >= 30 + 4  # the iterations of the three failures count as well
    # pose and loads go there on the straight way: as four steps asked for one by one
    other = hanging_arm()
    other.advance(first, begin, STEP_S)
    for k in range(1, 5):
        share = 0.25 * k
        pose = first.interpolated(flange, share)
        expected = other.advance(pose, begin.interpolated(loads, share), 0.25 * STEP_S)
    assert arm.state.positions == pytest.approx(other.state.positions, abs=1e-9)
    assert reply.wrench.force == pytest.approx(expected.wrench.force, abs=1e-4)


def test_a_two_step_integrator_does_not_look_back_over_a_change_of_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    had_earlier: list[bool] = []
    step = Stepper.step

    def halves_only(self: Stepper, state: Any, flange: Pose, loads: Any, step_s: float, *rest: Any) -> Any:
        if step_s > 0.6 * STEP_S:
            raise ConvergenceError("too long", 1.0, 1)
        had_earlier.append(state.earlier is not None)
        return step(self, state, flange, loads, step_s, *rest)

    arm = hanging_arm(dynamics=replace(TIGHT, integrator="bdf2"))
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))
    for k in (1, 2):
        arm.advance(moving(k * STEP_S), loads, STEP_S)
    assert arm.state.earlier is not None
    with monkeypatch.context() as patch:
        patch.setattr(Stepper, "step", halves_only)
        arm.advance(moving(3 * STEP_S), loads, STEP_S)
    assert had_earlier == [False, True]  # both halves are of one length
    assert arm.state.earlier is None  # the next step is a whole one again


def test_after_a_failure_the_state_is_that_before(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = hanging_arm()
    before, lengths = arm.state, []
    step = Stepper.step

    def first_half_only(
        self: Stepper, state: Any, flange: Pose, loads: Any, step_s: float, *rest: Any
    ) -> Any:
        lengths.append(step_s)
        if len(lengths) == 2:
            return step(self, state, flange, loads, step_s, *rest)
        raise ConvergenceError("no", 1.0, 1)

    monkeypatch.setattr(Stepper, "step", first_half_only)
    with pytest.raises(ConvergenceError):
        arm.advance(moving(0.01), no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)), STEP_S)
    assert min(lengths) == STEP_S / 32  # five halvings
    assert arm.state is before


def test_mass_properties_are_of_the_present_shape() -> None:
    arm = hanging_arm()
    mass = arm.mass_properties()
    assert mass.mass_kg == pytest.approx(arm.body.mass_kg)
    assert mass.center == pytest.approx(arm.body.node_mass @ arm.state.positions / arm.body.mass_kg)
    assert mass.center[2] < HANGING.translation[2] - 0.01


def test_an_exchange_that_is_one_tick_late_bears_a_quarter_of_the_mass_with_bdf2() -> None:
    # d_n+1 = -r (9 d_n - 6 d_n-1 + d_n-2) / 4: its largest root crosses the unit circle at r = 1 / gain
    arm = hanging_arm(dynamics=replace(TIGHT, integrator="bdf2"))
    limit = 1.0 / exchange_gain(arm.reaction_weights)
    for ratio, grows in ((0.99 * limit, False), (1.01 * limit, True)):
        roots = np.roots([1.0, 2.25 * ratio, -1.5 * ratio, 0.25 * ratio])
        assert (np.abs(roots).max() > 1.0) == grows
    assert exchange_gain(hanging_arm().reaction_weights) == 1.0
