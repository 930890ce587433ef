"""A coupled pair that returns to a saved state goes on as it did from there the first time, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.base.columns import TickRow
from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.base.state import restore_states, states_of
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import InputError
from cosim.soft.elements.open_caps import OpenCapSolver
from cosim.soft.linear.cholesky import EnvelopeCholesky
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import Integrator, StepOptions
from tests.coupling.pads import Grasp
from tests.coupling.test_staggered import Rig, rig
from tests.soft.bodies import HANGING, hexagon_arm, no_load
from tests.soft.test_strain_rates import lossy

STEP_S = 0.002
LIGHT_KG = 0.005  # at 2 ms the pads' answer is many times heavier: it gives way


def swung(arm: FilmRobot, first: int, last: int, pressure_Pa: float = 5e3) -> list[Array]:
    """Return the positions after each of the steps of a swinging flange, and the forces at its nodes."""
    loads, found = no_load(arm.body, pressure_Pa=(pressure_Pa,)), []
    for k in range(first, last):
        turn = rotation_from_vector(np.array([0.0, 0.02 * np.sin(0.1 * k), 0.0]))
        reply = arm.advance(Pose(turn @ HANGING.rotation, HANGING.translation), loads, STEP_S)
        found += [arm.state.positions, arm.reaction, np.array([reply.residual_N])]
    return found


def soft_arm(closed: bool = True, loss_factor: float = 0.0, **options: Any) -> FilmRobot:
    """Return an arm of two units in its drawn shape."""
    body = lossy(hexagon_arm(2, closed=closed), loss_factor)
    return FilmRobot(body, HANGING, NewtonOptions(), StepOptions(damping_per_s=5.0, **options))


def same(found: list[Array], expected: list[Array]) -> bool:
    """Whether all arrays are equal bit for bit."""
    return all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
@pytest.mark.parametrize(("closed", "loss_factor"), [(True, 0.0), (False, 0.0), (True, 0.05)])
def test_a_soft_arm_repeats_itself(integrator: str, closed: bool, loss_factor: float) -> None:
    arm = soft_arm(closed, loss_factor, integrator=integrator)
    assert isinstance(arm.equilibrium_solver.solver.linear, EnvelopeCholesky if closed else OpenCapSolver)
    swung(arm, 0, 20)
    state = arm.full_state
    assert state.soft.earlier is not None
    assert state.newton.factor is not None  # the next step begins with a factorisation of this one
    expected = swung(arm, 20, 32)
    arm.full_state = state
    assert same(swung(arm, 20, 32), expected)
    other = soft_arm(closed, loss_factor, integrator=integrator)
    swung(other, 0, 3, 2e3)
    other.full_state = state
    assert same(swung(other, 20, 32), expected)


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_the_kept_factorisation_and_the_step_before_are_parts_of_the_state(integrator: str) -> None:
    arm = soft_arm(integrator=integrator)
    swung(arm, 0, 20)
    state = arm.full_state
    expected = swung(arm, 20, 32)
    if integrator == "bdf2":
        state = replace(state, soft=replace(state.soft, earlier=None))
    else:
        state = replace(state, newton=replace(state.newton, key=None, factor=None))
    arm.full_state = state
    assert not same(swung(arm, 20, 32), expected)


def test_saving_changes_nothing_and_branches_do_not_disturb_each_other() -> None:
    arm, other = soft_arm(), soft_arm()
    plain = swung(other, 0, 24)
    found, states = [], []
    for k in range(24):
        states.append(arm.full_state)
        found += swung(arm, k, k + 1)
    assert same(found, plain)
    # a branch taken in between, with other loads, spoils neither the states nor their factorisations
    arm.full_state = states[10]
    swung(arm, 10, 20, 1e3)
    for k in (20, 5, 10):
        arm.full_state = states[k]
        assert same(swung(arm, k, 24), plain[3 * k :])


def test_what_is_held_is_part_of_the_state() -> None:
    arm = soft_arm()
    swung(arm, 0, 5)
    state = arm.full_state
    expected = swung(arm, 5, 10)
    held = np.zeros((arm.body.nodes, 3), dtype=bool)
    held[arm.body.tip] = True
    arm.hold_components(held, HANGING)
    swung(arm, 5, 8)
    arm.full_state = state
    assert same(swung(arm, 5, 10), expected)


def test_a_state_of_another_body_is_refused() -> None:
    arm = soft_arm()
    other = FilmRobot(hexagon_arm(1), HANGING, NewtonOptions(), StepOptions())
    with pytest.raises(InputError, match="has 90 nodes, this one 48"):
        other.full_state = arm.full_state


def grasped(here: Grasp, ticks: int) -> list[Array]:
    """Return what a grasp does in some ticks."""
    found = []
    for _ in range(ticks):
        report = here.tick()
        found += [here.soft.state.positions, here.cube_position, report.force, report.torque]
    return found


def saved_of(here: Grasp | Rig) -> tuple[Any, dict[str, Any]]:
    """Return the states of the soft side and of all other parts of a pair."""
    assert here.coupling is not None
    return here.soft.full_state, states_of({"scene": here.scene, **here.coupling.parts()})


def restore(here: Grasp | Rig, saved: tuple[Any, dict[str, Any]]) -> None:
    """Bring all parts of a pair to their states."""
    assert here.coupling is not None
    here.soft.full_state = saved[0]
    restore_states({"scene": here.scene, **here.coupling.parts()}, saved[1])


def test_a_grasp_repeats_itself_with_friction_and_a_body_that_gives_way() -> None:
    here = Grasp(LIGHT_KG, STEP_S)
    grasped(here, 60)
    states = saved_of(here)
    assert here.ratio > 1.0
    memory = here.exchange.memory
    assert len(memory.key) > 10
    expected = grasped(here, 25)
    restore(here, states)
    assert same(grasped(here, 25), expected)
    other = Grasp(LIGHT_KG, STEP_S)
    grasped(other, 7)
    restore(other, states)
    assert same(grasped(other, 25), expected)
    # the anchors of the stick springs matter
    contact = states[1]["contact"]
    untied = replace(contact, memory=memory._replace(offset=np.zeros_like(memory.offset)))
    restore(here, (states[0], {**states[1], "contact": untied}))
    assert not same(grasped(here, 25), expected)


@pytest.mark.parametrize("mass_kg", [LIGHT_KG, 4.0 * LIGHT_KG])
def test_saving_changes_nothing_in_a_grasp(mass_kg: float) -> None:
    """A saved state holds the factorisation, so a kernel stops earlier in a step that Python then takes."""
    plain, saved = Grasp(mass_kg, STEP_S), Grasp(mass_kg, STEP_S)
    for _ in range(25):
        expected = grasped(plain, 1)
        states = saved_of(saved)
        assert same(grasped(saved, 1), expected)
    restore(plain, states)
    assert same(grasped(plain, 1), expected)


def test_a_contact_that_ends_right_after_the_state_pushes_no_longer() -> None:
    first, second = Grasp(LIGHT_KG, STEP_S).scene, Grasp(LIGHT_KG, STEP_S).scene
    cube = np.array([first.body_names.index("cube")])
    first.bodies.apply(cube, np.array([[0.0, 0.0, 5.0]]), np.zeros((1, 3)))
    second.state = first.state
    heights = []
    for scene in (first, second):
        scene.bodies.apply(cube[:0], np.zeros((0, 3)), np.zeros((0, 3)))
        for _ in range(3):
            scene.step()
        heights.append(scene.body_poses()[0][cube[0], 2])
    assert heights[0] == heights[1] < 1.5


def driven(here: Rig, first: int, last: int) -> list[Array]:
    """Return what a coupled pair does while its joints swing."""
    found = []
    for k in range(first, last):
        entry: TickRow = here.ticks(1, 0.02 * np.sin(0.1 * k))[0]
        figures = (entry.rigid_power_W, entry.soft_power_W, entry.residual_N, entry.stability_ratio)
        found += [here.scene.joint_position, here.soft.state.positions, entry.wrench.force, np.array(figures)]
    return found


@pytest.mark.parametrize(
    ("carried_kg", "integrator"), [(0.0, "implicit_euler"), (16.0, "implicit_euler"), (16.0, "bdf2")]
)
def test_a_staggered_pair_repeats_itself(carried_kg: float, integrator: Integrator) -> None:
    here = rig(carried_kg, integrator=integrator)
    driven(here, 0, 13)  # between two weighings
    states = saved_of(here)
    assert states[1]["scheme"].added.any() == (carried_kg > 0.0)
    expected = driven(here, 13, 30)
    other = rig(carried_kg, integrator=integrator)
    for pair in (here, other):
        restore(pair, states)
        assert same(driven(pair, 13, 30), expected)
