"""Cables of commanded length on a section arm, against those of the film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_vector
from cosim.coupling.robots.beam_robot import BeamRobot
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import base_tension
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.step_scheme import StepOptions
from tests.coupling.test_section_touch import AIM, LAW, UP
from tests.small_section import body, section
from tests.soft.contacts import half_space

FLANGE = Pose(rotation_from_vector(np.array([0.0, np.pi, 0.0])), np.array([0.3, 0.1, 0.7]))
GAS = Loads((25e3,), (0.0, 0.0))


def arms() -> tuple[BeamRobot, FilmRobot]:
    statics, dynamics = NewtonOptions(), StepOptions()
    return BeamRobot(section(), FLANGE, statics, dynamics), FilmRobot(body(), FLANGE, statics, dynamics)


def wound(arm: BeamRobot | FilmRobot, shortening_m: float) -> tuple[Equilibrium, Loads]:
    """Return the arm's equilibrium with the first cable wound in from where it gets taut."""
    free = arm.start(FLANGE, GAS)
    route = body().cables[0].length(free.state.positions)
    loads = replace(GAS, cable_length_m=(route - shortening_m, None))
    return arm.follow(free, FLANGE, loads), loads


def tension(found: Equilibrium) -> float:
    length = found.loads.cable_length_m[0]
    assert length is not None
    return base_tension(body().cables[0], found.state.positions, length)


@pytest.mark.parametrize("shortening_m", [-1e-3, 2e-3, 6e-3])
def test_a_wound_cable_pulls_as_on_the_film(shortening_m: float) -> None:
    arm, film = arms()
    (found, loads), (expected, _) = wound(arm, shortening_m), wound(film, shortening_m)
    assert tension(found) == pytest.approx(tension(expected), rel=0.08, abs=1e-6)
    assert (tension(found) > 0.1) == (shortening_m > 0.0)
    tips = [
        body().tip_position(e.state.positions) - body().tip_position(a.start(FLANGE, GAS).state.positions)
        for e, a in ((found, arm), (expected, film))
    ]
    assert tips[0] == pytest.approx(tips[1], abs=0.05 * float(np.linalg.norm(tips[1])) + 1e-6)
    # the same tension, given
    given = replace(GAS, cable_tension_N=(tension(found), 0.0))
    there = arm.follow(arm.start(FLANGE, GAS), FLANGE, given)
    assert there.state.positions == pytest.approx(found.state.positions, abs=1e-7)
    assert loads.cable_length_m == found.loads.cable_length_m


def test_it_stays_at_rest_and_is_wound_in_motion() -> None:
    arm, film = arms()
    paths = []
    for a in (arm, film):
        found, loads = wound(a, 2e-3)
        a.commit(found)
        before = a.state.positions.copy()
        for _ in range(3):
            a.advance(FLANGE, loads, 2e-3)
        # statics end at 1e-6 N, steps at 1e-4 N
        assert a.state.positions == pytest.approx(before, abs=1e-6)
        path = []
        for k in range(1, 21):
            length = loads.cable_length_m[0]
            assert length is not None
            a.advance(FLANGE, replace(loads, cable_length_m=(length - 1e-4 * k, None)), 2e-3)
            path.append(a.body.tip_position(a.state.positions) - body().tip_position(before))
        paths.append(np.array(path))
    assert np.abs(paths[1]).max() > 5e-4
    assert np.abs(paths[0] - paths[1]).max() < 0.1 * np.abs(paths[1]).max()


def test_the_tangent_holds_the_cable() -> None:
    arm, _ = arms()
    found, loads = wound(arm, 2e-3)
    arm.commit(found)
    here, step_s = arm.state, 2e-3
    floor = half_space(arm.contact_surface(), UP, 0.0, LAW)
    arm.advance_accurately(FLANGE, loads, step_s, AIM)
    force = np.random.default_rng(1).normal(0.0, 1.0, (1, body().nodes, 3))
    moved = arm.response(force, floor, step_s)
    assert moved is not None
    arm.restore(here)
    ends = []
    for sign in (1.0, -1.0):
        arm.advance_accurately(FLANGE, replace(loads, nodal_force=sign * 1e-3 * force[0]), step_s, AIM)
        ends.append(arm.state.positions)
        arm.restore(here)
    numeric = (ends[0] - ends[1]) / 2e-3
    # the tangent is symmetric, a cable that loses a fifth of its tension at every eyelet is not
    assert moved[0] == pytest.approx(numeric, abs=0.05 * float(np.abs(numeric).max()))
