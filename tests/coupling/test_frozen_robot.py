"""The soft side that does not deform: Newton and Euler, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_vector
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.coupling.robots.frozen_robot import FrozenRobot
from cosim.errors import InputError
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.tip_target import TipTarget
from tests.soft.bodies import HANGING, PRESSURE_Pa, hexagon_arm, no_load

STEP_S = 1e-3
SPIN = np.array([1.0, -2.0, 3.0])  # [rad/s], world axes
GRAVITY = np.array([0.0, 0.0, -9.81])


def frozen(air_drag_per_s: float = 0.0) -> FrozenRobot:
    """Return an inflated arm of two units, frozen in the equilibrium of its start."""
    arm = FrozenRobot(FilmRobot(hexagon_arm(2), HANGING, NewtonOptions(), StepOptions()), air_drag_per_s)
    arm.commit(arm.start(HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,))))
    return arm


def turning(time_s: float) -> Pose:
    """Return a flange that turns at a constant rate about its origin."""
    return Pose(rotation_from_vector(SPIN * time_s) @ HANGING.rotation, HANGING.translation)


def test_it_keeps_the_inflated_shape_of_the_start_and_its_weight() -> None:
    arm, flexible = frozen(), FilmRobot(hexagon_arm(2), HANGING, NewtonOptions(), StepOptions())
    found = flexible.start(HANGING, no_load(arm.body, pressure_Pa=(PRESSURE_Pa,)))
    assert arm.state.positions == pytest.approx(found.state.positions, abs=1e-12)
    assert (
        arm.volumes_m3[0] > 2.0 * FilmRobot(arm.body, HANGING, NewtonOptions(), StepOptions()).volumes_m3[0]
    )
    loads = no_load(arm.body, pressure_Pa=())
    reply = arm.advance(HANGING, loads, STEP_S)
    assert arm.state.positions == pytest.approx(found.state.positions, abs=1e-12)
    assert reply.wrench.force == pytest.approx(found.wrench.force, abs=1e-5)
    assert reply.wrench.torque == pytest.approx(found.wrench.torque, abs=1e-6)
    assert arm.pressures_Pa[0] == 0.0


def test_a_turning_flange_feels_euler_equations() -> None:
    # constant rate w: force = m (g - w x (w x c)), torque = c x m g - w x (J w), c and J about the flange
    errors = []
    for step in (STEP_S, 0.5 * STEP_S):
        arm = frozen()
        for k in range(1, 9):
            reply = arm.advance(turning(k * step), no_load(arm.body), step)
        mass = arm.mass_properties()
        center = mass.center - HANGING.translation
        central = np.cross(SPIN, np.cross(SPIN, center))
        force = mass.mass_kg * (GRAVITY - central)
        spatial = mass.spatial(HANGING.translation)
        torque = mass.mass_kg * np.cross(center, GRAVITY) - np.cross(SPIN, spatial[3:, 3:] @ SPIN)
        errors.append([np.abs(reply.wrench.force - force).max(), np.abs(reply.wrench.torque - torque).max()])
        assert np.linalg.norm(mass.mass_kg * central) > 10.0 * errors[-1][0]
    assert np.divide(*errors) == pytest.approx([2.0] * 2, rel=0.1)


def test_mass_properties_are_those_of_the_nodes() -> None:
    arm = frozen()
    arm.advance(turning(0.3), no_load(arm.body), STEP_S)
    mass, nodes = arm.mass_properties(), arm.body.node_mass
    assert mass.center == pytest.approx(nodes @ arm.state.positions / nodes.sum())
    offset = arm.state.positions - mass.center
    second = (nodes[:, None] * offset).T @ offset
    assert mass.inertia == pytest.approx(np.trace(second) * np.eye(3) - second)


def test_work_is_that_of_the_wrench_and_drag_takes_its_share() -> None:
    arm, damped = frozen(), frozen(air_drag_per_s=2.0)
    shifted = Pose(HANGING.rotation, HANGING.translation + np.array([1e-3, 0.0, 0.0]))
    reply, slowed = (a.advance(shifted, no_load(a.body), STEP_S) for a in (arm, damped))
    way = shifted.translation - HANGING.translation
    work = arm.supplied_work(np.tile(way, (arm.body.nodes, 1)))
    assert work == pytest.approx(-reply.wrench.force @ way, rel=1e-9)
    # 1 m/s
    assert slowed.wrench.force[0] - reply.wrench.force[0] == pytest.approx(-2.0 * arm.body.mass_kg)


def test_a_contact_pushes_on_the_flange() -> None:
    arm = frozen()
    surface, tip = arm.contact_surface(), arm.body.tip[0]
    point = int(np.flatnonzero((surface.nodes == tip).all(axis=1))[0])
    one, law = slice(point, point + 1), ContactLaw(smoothing_m=1e-6)
    depth, up = 1e-3, np.array([[0.0, 0.0, 1.0]])
    offset = np.array([arm.state.positions[tip, 2] + depth])
    planes = ContactPlanes.empty(1, law).changed(
        nodes=surface.nodes[one], weights=surface.weights[one], slots=surface.slots[one], normal=up,
        offset=offset, stiffness=np.array([500.0]), anchor=arm.state.positions[[tip]],
    )  # fmt: skip
    free = arm.advance(HANGING, no_load(arm.body), STEP_S)
    pushed = arm.advance(HANGING, no_load(arm.body, contact=planes), STEP_S)
    assert pushed.wrench.force - free.wrench.force == pytest.approx([0.0, 0.0, 0.5], abs=1e-3)
    lever = arm.state.positions[tip] - HANGING.translation
    assert pushed.wrench.torque - free.wrench.torque == pytest.approx(0.5 * np.cross(lever, up[0]), abs=1e-3)
    assert not arm.response(np.ones((2, arm.body.nodes, 3)), planes, STEP_S).any()


def test_targets_of_the_tip_are_refused() -> None:
    arm = frozen()
    here = arm.solve(arm.state, HANGING, no_load(arm.body))
    for find in (arm.find_tensions, arm.find_flange_pose):
        with pytest.raises(InputError, match="plan its tip targets on the flexible one"):
            find(here, TipTarget(position=np.zeros(3)))


def test_it_goes_on_from_a_saved_state_bit_for_bit() -> None:
    arm, other = frozen(), frozen()
    loads = no_load(arm.body, pressure_Pa=(1e3,))
    arm.advance(turning(0.001), loads, STEP_S)
    saved = arm.full_state
    expected = arm.advance(turning(0.003), loads, STEP_S)
    other.full_state = saved
    assert other.pressures_Pa[0] == 1e3
    again = other.advance(turning(0.003), loads, STEP_S)
    assert (again.wrench.force == expected.wrench.force).all()
    assert (other.state.velocities == arm.state.velocities).all()
    with pytest.raises(InputError, match="nodes"):
        other.full_state = replace(saved, shape=saved.shape[:-1])


def test_an_undone_step_leaves_nothing_behind() -> None:
    arm = frozen()
    arm.advance(turning(0.1), no_load(arm.body), STEP_S)
    before, mass, state = arm.full_state, arm.mass_properties(), arm.state
    arm.advance(turning(0.3), no_load(arm.body, pressure_Pa=(1e3,)), STEP_S)
    arm.restore(state)
    after = arm.full_state
    assert arm.mass_properties().center.tobytes() == mass.center.tobytes()
    assert after.supplied.tobytes() == before.supplied.tobytes()
    assert after.pressures_Pa == before.pressures_Pa
