"""The iterated exchange against one body, against stiff contact, and back to where a tick began."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.base.state import restore_states, states_of
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.iterated import IteratedCoupling, IterationOptions, QuasiNewton
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.errors import ConvergenceError, SolverError
from cosim.rigid.build.description import ServoGains
from tests.coupling.pads import GRASP, CoupledGrasp
from tests.coupling.slider import OneBody, Slider
from tests.coupling.test_staggered import largest_speed, rig

RATIOS = (0.5, 0.99, 1.01, 2.0, 10.0)
SOFT_PA, STIFF_PA = 1e8, 1e11  # film stiffness h^2 over a node's mass: some 10, some 10^4


def without_mass(interface: Interface) -> StaggeredCoupling:
    """Return the plain exchange."""
    return StaggeredCoupling(interface, np.inf)


@pytest.mark.parametrize("young_modulus_Pa", [SOFT_PA, STIFF_PA])
@pytest.mark.parametrize("ratio", RATIOS)
def test_carriage_and_strip_move_as_one_body(ratio: float, young_modulus_Pa: float) -> None:
    slider = Slider(ratio, young_modulus_Pa)
    one, coupling = OneBody(slider, young_modulus_Pa), IteratedCoupling(slider.interface)
    trials = []
    for _ in range(60):
        entry = slider.tick(coupling)
        one.tick()
        trials.append(entry.trials)
        # tolerance 1e-9 of 5 N on at least 17 g: 3e-7 m/s^2 at worst, for 0.12 s
        assert abs(slider.height_m - one.height_m) < 1e-9
        assert entry.scheme == "iterated"
        assert entry.trials <= 7
        assert entry.interface_residual <= 1e-9
        assert entry.power_error < 1e-8
        assert entry.momentum_error < 1e-10
        assert not entry.algorithmic_mass
    assert one.height_m > 0.01
    assert entry.stability_ratio == pytest.approx(ratio)
    # each tick begins with the secants of the one before: without them 3.0 to 3.5, stiff 1.6 to 2.1
    assert np.mean(trials[2:]) < (2.95 if young_modulus_Pa == SOFT_PA else 1.78)


@pytest.mark.parametrize("ratio", [2.0, 10.0])
def test_without_iterations_the_same_pair_flies_apart(ratio: float) -> None:
    slider = Slider(ratio, STIFF_PA)
    one, coupling = OneBody(slider, STIFF_PA), without_mass(slider.interface)
    for _ in range(60):
        try:
            slider.tick(coupling)
        except SolverError:
            return
        one.tick()
        if abs(slider.height_m - one.height_m) > 0.5:
            return
    pytest.fail("the staggered exchange is stable")


@pytest.mark.parametrize("tick_s", [1e-3, 5e-3])
def test_a_light_cube_is_held_without_carrying_a_mass(tick_s: float) -> None:
    here = CoupledGrasp(0.01, tick_s, IteratedCoupling)
    before, trials, furthest = here.grasp.scene.state.armature, [], 0.0
    for _ in range(round(0.1 / tick_s)):
        entry = here.tick()
        trials.append(entry.trials)
        assert entry.momentum_error < 1e-10
        furthest = max(furthest, float(np.abs(here.grasp.cube_position - GRASP).max()))
    assert entry.contact_ratio > 1.0
    assert furthest < 1e-3  # it falls until it sticks: by 3 g h^2, as the film meets it a tick ahead
    # by Newton's steps with the contacts' tangent: without it, 10 and more
    assert max(trials) <= 8
    assert np.mean(trials) < 4.0
    assert np.array_equal(here.grasp.scene.state.armature, before)


def test_an_arm_without_rotor_inertia_holds_a_heavy_soft_arm() -> None:
    # the plain exchange diverges above a ratio of 1 to 1.4
    weak = {"armature": 0.01, "gains": ServoGains(np.full(6, 200.0), np.full(6, 5.0))}
    here = rig(4.0, **weak)
    here.coupling = IteratedCoupling(here.coupling.interface)
    entries = here.ticks(60, 0.002)
    assert entries[-1].stability_ratio > 1.4
    assert max(entry.trials for entry in entries) <= 7
    assert max(entry.power_error for entry in entries) < 1e-8
    assert np.abs(here.scene.joint_position - here.joints).max() < 0.003
    other = rig(4.0, **weak)
    other.coupling = without_mass(other.coupling.interface)
    assert largest_speed(other, 60) > 20.0 * largest_speed(here, 60)


def test_under_bdf2_the_soft_sides_inertia_is_weighed_as_it_steps() -> None:
    # weighed as with implicit Euler, h^2 S is 2.25 times too small: 8 trials a tick, 4 in the grasp
    gains = ServoGains(np.full(6, 200.0), np.full(6, 5.0))
    here = rig(4.0, integrator="bdf2", armature=0.01, gains=gains)
    here.coupling = IteratedCoupling(here.coupling.interface)
    assert max(entry.trials for entry in here.ticks(12, 0.002)[2:]) <= 5
    held = CoupledGrasp(0.01, 2e-3, IteratedCoupling, "bdf2")
    assert np.mean([held.tick().trials for _ in range(20)]) < 3.2


def test_a_tick_that_fails_leaves_both_sides_where_it_began() -> None:
    here = CoupledGrasp(0.01, 2e-3, IteratedCoupling)
    exchange = here.grasp.exchange
    here.tick()
    here.coupling = IteratedCoupling(here.interface, IterationOptions(iterations_max=1))
    rigid, soft, contact = here.grasp.scene.state, here.grasp.soft.state, exchange.state
    with pytest.raises(ConvergenceError, match=r"after 1 trials .* coupling\.tolerance = 1e-09"):
        here.tick()
    again = here.grasp.scene.state
    assert np.array_equal(again.integration, rigid.integration)
    assert here.grasp.soft.state is soft
    for found, kept in zip(exchange.memory, contact.memory, strict=True):
        np.testing.assert_array_equal(found, kept)


def states(here: CoupledGrasp, ticks: int) -> list[Array]:
    """Return where cube and film are after each of some ticks."""
    found = []
    for _ in range(ticks):
        here.tick()
        found += [here.grasp.cube_position, here.grasp.soft.state.positions]
    return found


def test_a_saved_state_repeats_itself() -> None:
    here = CoupledGrasp(0.02, 2e-3, IteratedCoupling)
    states(here, 15)
    saved = here.grasp.scene.state, here.grasp.soft.full_state, states_of(here.coupling.parts())
    expected = states(here, 6)
    here.grasp.scene.state = saved[0]
    here.grasp.soft.full_state = saved[1]
    restore_states(here.coupling.parts(), saved[2])
    assert all(np.array_equal(a, b) for a, b in zip(states(here, 6), expected, strict=True))


def test_a_linear_problem_takes_one_secant_per_unknown_and_is_remembered() -> None:
    random = np.random.default_rng(3)
    slope = -np.eye(5) - random.normal(size=(5, 5))
    inverse = -np.eye(5)
    for expected in (7, 2):
        newton, load, root = QuasiNewton(inverse), np.zeros(5), random.normal(size=5)
        for k in range(expected):
            residual = slope @ (load - root)
            load = load + newton.step(load, residual)
            assert k < expected - 1 or np.abs(residual).max() < 1e-9
        inverse = newton.inverse(1.0)
    np.testing.assert_allclose(inverse @ slope, np.eye(5), atol=1e-6)


def test_secants_as_short_as_rounding_are_not_remembered() -> None:
    newton = QuasiNewton(-np.eye(3))
    newton.step(np.zeros(3), np.array([1e-7, 0.0, 0.0]))
    newton.step(np.array([1e-7, 0.0, 0.0]), np.array([3e-7, 0.0, 0.0]))  # a slope of +2 where -1 is known
    np.testing.assert_array_equal(newton.inverse(1.0), -np.eye(3))
    assert newton.inverse(0.1)[0, 0] == pytest.approx(0.5)


def test_loose_loads_agree_sooner() -> None:
    trials = []
    for tolerance in (1e-4, 1e-9):
        slider = Slider(10.0, SOFT_PA)
        coupling = IteratedCoupling(slider.interface, replace(IterationOptions(), tolerance=tolerance))
        trials.append(sum(slider.tick(coupling).trials for _ in range(20)))
    assert trials[0] < trials[1]


def test_beams_answer_as_closely_as_the_trials_of_a_tick_ask() -> None:
    # their turns are sought to 3e-9 rad in an ordinary step: 3e-9 of the loads, and the trials never agree
    gripper = cosim.Simulation("gripper_lifts_roll", overrides={"coupling.scheme": "iterated"})
    assert gripper.step(12).interface_residual <= 1e-9
