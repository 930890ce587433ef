"""Square units fold on a chain as their film does: bends by cables, and the gas within."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.reduced.fitting import Effort
from cosim.reduced.section_model import RingFrames, SectionBody, SectionModel
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import SoftState
from cosim.stepping.film_contact import film_law
from tests.small_section import kept_model

UNITS = 3
PRESSURE_Pa = 40e3  # the end of the small model: its splines over pressure are coarse
TENSIONS_N = (0.25, 1.0, 2.0, 4.0)


@cache
def finger() -> tuple[SectionModel, SoftBody, FilmContactLaw]:
    """Return the model of a short finger, the film of which it is, and the contact of its units."""
    scenario = load_scenario("gripper_lifts_roll")
    robot = replace(file_of(scenario, "a finger"), copies=None, palm=None)
    cables = tuple(replace(cable, units=(1, UNITS)) for cable in robot.cables)
    assert robot.stack is not None
    robot = replace(robot, stack=replace(robot.stack, units=UNITS), cables=cables)
    body = build_soft_body(robot, scenario.model)
    body = body.with_other(Cable, *(replace(cable, directed=False, loss_N=0.0) for cable in body.cables))
    law = film_law(scenario)
    assert law is not None
    smooth = replace(law, friction=0.0, throughout=True, inside=False)
    effort = Effort(levels=6, samples=24, intervals=4)
    return kept_model(body, PRESSURE_Pa, smooth, effort, folds=True), body, smooth


def film_of_finger() -> EquilibriumSolver:
    _, body, smooth = finger()
    clamp = Clamp.of_base(body)
    newton = NewtonSolver(FilmPotential(body), clamp.mask(body.nodes))
    options = NewtonOptions(tolerance_N=1e-5, start_tolerance_N=1e-5, iterations_max=60)
    return EquilibriumSolver(newton, clamp, options, SelfContact(body, smooth))


def test_square_units_fold_as_their_film_does() -> None:
    model, body, _ = finger()
    assert model.failures == 0
    section, system, film = SectionBody(body, model), FilmPotential(body), film_of_finger()
    chain, frames = ChainSolver(section), section.straight(PRESSURE_Pa)
    here = film.solve(SoftState.drawn(body, Pose()), Pose(), Loads((1e3,), (0.0, 0.0)))
    here = film.follow(here, Pose(), Loads((PRESSURE_Pa,), (0.0, 0.0)))
    bends = []
    for tension in TENSIONS_N:
        loads = Loads((PRESSURE_Pa,), (tension, tension))
        here = film.follow(here, Pose(), loads)
        there = section.frames.fit(here.state.positions, Pose())
        found = chain.solve(frames, np.arange(len(frames)) > 0, loads, 1e-6, 100)
        assert found.outcome is Outcome.CONVERGED
        frames = found.frames
        # of unit to unit; half units hardly bend
        both = [np.linalg.norm(section.frames.strains(each)[1:-1, 3:5], axis=1) for each in (there, frames)]
        assert both[1] == pytest.approx(both[0], rel=0.04, abs=0.02)
        bends.append(float(np.degrees(np.arcsin(both[0].max()))))
        gas = float(system.gas.enclosed_volumes(here.state.positions[None]).sum())
        assert section.volumes(there[None], np.array([PRESSURE_Pa]))[0, 0] == pytest.approx(gas, rel=0.03)
    assert bends[0] < 9.0  # before the sides meet
    assert bends[-1] > 16.0  # units pressed flat on one another


@pytest.mark.parametrize("pull_m_s2", [0.0, 9.81, -3.0])
def test_units_without_gas_bear_themselves(pull_m_s2: float) -> None:
    """Hanging or pressed together; a half unit of whose film no shortened sample was known fell together."""
    model, body, _ = finger()
    section, loads = SectionBody(body, model), Loads((0.0,), (0.0, 0.0), (0.0, 0.0, pull_m_s2))
    here = film_of_finger().solve(SoftState.drawn(body, Pose()), Pose(), loads)
    there = section.frames.fit(here.state.positions, Pose())
    found = ChainSolver(section).solve(there, np.arange(len(there)) > 0, loads, 1e-6, 100)
    assert found.outcome is Outcome.CONVERGED
    lengths = [section.frames.strains(each)[:, 2] for each in (there, found.frames)]
    assert lengths[1] == pytest.approx(lengths[0], rel=0.1)


def test_only_whole_square_units_have_rims() -> None:
    square = load_scenario("gripper_lifts_roll")
    frames = RingFrames.of(build_soft_body(file_of(square, "fingers"), square.model))
    assert frames.rims.size == 0  # unless they are asked to fold
    rims = replace(frames, folds=True).rims
    assert rims.shape == (27, 4, 2)
    whole = np.tile([False, *[True] * 7, False], 3)
    assert np.abs(rims[whole]) == pytest.approx(0.03, rel=1e-6)
    assert not rims[~whole].any()
    hexagon = load_scenario("ur5e_hexagon_arm")
    arm = RingFrames.of(build_soft_body(file_of(hexagon, "an arm"), hexagon.model))
    assert replace(arm, folds=True).rims.size == 0
