"""A section arm in contact: momentum, tangent, and steps that are taken again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_vector
from cosim.coupling.robots.beam_robot import BeamRobot
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_scheme import StepAccuracy, StepOptions
from tests.small_section import body, section
from tests.soft.contacts import half_space

FLANGE = Pose(rotation_from_vector(np.array([0.0, np.pi, 0.0])), np.array([0.3, 0.1, 0.7]))
UP = np.array([0.0, 0.0, 1.0])
LAW = ContactLaw(1e8, 3e-4, 3e-4)
STEP_S = 0.002
AIM = StepAccuracy(1e-9)


def lowered(share: float = 1.0) -> Pose:
    return Pose(FLANGE.rotation, FLANGE.translation - share * np.array([2e-4, 0.0, 1e-3]))


def resting(damping_per_s: float = 0.0) -> tuple[BeamRobot, Loads]:
    """Return an arm at rest above a floor that its tip nearly touches, and loads with that floor."""
    arm = BeamRobot(section(), FLANGE, NewtonOptions(), StepOptions(damping_per_s=damping_per_s))
    gas = Loads((25e3,), (0.0, 0.0))
    arm.commit(arm.start(FLANGE, gas))
    surface = arm.contact_surface()
    points = surface.points(arm.state.positions)
    lowest = float(points[:, 2].min())
    return arm, replace(gas, contact=half_space(surface, UP, lowest, LAW, 0.02, points))


def test_momentum_changes_by_what_presses() -> None:
    arm, loads = resting()
    assert loads.contact is not None
    mass, velocity, before = body().mass_kg, np.zeros(3), arm.mass_properties().center
    for k in range(1, 6):
        reply = arm.advance_accurately(lowered(0.2 * k), loads, STEP_S, AIM)
        after = arm.mass_properties().center
        gained = mass * ((after - before) / STEP_S - velocity) / STEP_S
        velocity, before = (after - before) / STEP_S, after
        pressed = loads.contact.at(arm.state.positions).force.sum(axis=0)
        # differences of centres of mass are good to some 1e-16 m over h^2
        acting = -reply.wrench.force + pressed + mass * np.array([0.0, 0.0, -9.81])
        assert gained == pytest.approx(acting, abs=1e-6 * max(1.0, np.abs(gained).max()))
    assert pressed[2] > 1.0
    assert abs(pressed[0]) > 0.1


def test_the_tangent_is_that_of_the_step() -> None:
    arm, loads = resting(damping_per_s=20.0)
    assert loads.contact is not None
    arm.advance_accurately(lowered(), loads, STEP_S, AIM)
    random = np.random.default_rng(1)
    forces = random.normal(0.0, 1.0, (2, body().nodes, 3))
    found = arm.response(forces, loads.contact, STEP_S)
    assert found is not None
    arm, loads = resting(damping_per_s=20.0)
    before = arm.state
    for force, moved in zip(forces, found, strict=True):
        ends = []
        for sign in (1.0, -1.0):
            arm.advance_accurately(lowered(), replace(loads, nodal_force=sign * 1e-5 * force), STEP_S, AIM)
            ends.append(arm.state.positions)
            arm.restore(before)
        numeric = (ends[0] - ends[1]) / 2e-5
        # the step's residual, 1e-9 N, over the differences' 1e-5 N
        assert moved == pytest.approx(numeric, abs=2e-3 * float(np.abs(numeric).max()))


def test_a_step_taken_again_ends_at_the_same_place() -> None:
    arm, loads = resting()
    before, ends = arm.state, []
    for start in (None, np.zeros(0), np.zeros(0)):
        reply = arm.advance_accurately(lowered(), loads, STEP_S, StepAccuracy(1e-9, start))
        assert reply.residual_N < 1e-9
        ends.append(arm.state.positions)
        arm.restore(before)
        for _ in range(10):  # however many trials there are: films of past states are forgotten
            arm.advance(lowered(0.5), loads, STEP_S)
            assert arm.state is not before
            arm.restore(before)
    assert ends[1] == pytest.approx(ends[0], abs=1e-12)
    assert ends[2] == pytest.approx(ends[0], abs=1e-12)
