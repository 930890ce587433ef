"""A chain fitted to a film, beside that film: the same shape under the same loads, the same gas within it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Mask, Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.reduced.fitting import Effort, build_model
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.state import Equilibrium, SoftState
from tests.small_section import LAW, body, framed_section, section

LEANING = (4.0, 0.0, 9.0)
TOLERANCE_N = 1e-6


def free() -> Mask:
    """Return which frames can move: all but the flange's."""
    return np.arange(len(section().frames)) > 0


def film(pressures_Pa: tuple[float, ...]) -> tuple[FilmPotential, list[Equilibrium]]:
    """Return the film's system and its equilibria at pressures, leaning and pulled by a cable."""
    system, clamp = FilmPotential(body()), Clamp.of_base(body())
    solver = EquilibriumSolver(NewtonSolver(system, clamp.mask(body().nodes)), clamp, NewtonOptions())
    begin = solver.solve(SoftState.drawn(body(), Pose()), Pose(), Loads((1e3,), (0.0, 0.0)))
    return system, [
        solver.follow(begin, Pose(), Loads((pressure,), (2.0, 0.0), LEANING)) for pressure in pressures_Pa
    ]


def test_a_chain_in_the_film_s_shape_encloses_what_the_film_does() -> None:
    pressures = (5e3, 10e3, 20e3, 30e3, 39e3)
    system, found = film(pressures)
    x = np.array([each.state.positions for each in found])
    chain = section().volumes(
        np.array([section().frames.fit(shape, Pose()) for shape in x]), np.array(pressures)
    )[:, 0]
    # the splines of this small model are coarse: 2 % at both ends of its range
    assert chain == pytest.approx(system.gas.enclosed_volumes(x).sum(axis=1), rel=0.04)


def test_an_equilibrium_is_balanced_and_where_the_film_has_it() -> None:
    loads = Loads((25e3,), (2.0, 0.0), LEANING)
    chain, start = ChainSolver(section()), section().straight(25e3)
    found = chain.solve(start, free(), loads, TOLERANCE_N, 40)
    assert (found.outcome, found.iterations > 0) == (Outcome.CONVERGED, True)
    out_of_balance = [np.abs(chain.evaluate(f, loads, 25e3)[1:, :3]).max() for f in (start, found.frames)]
    assert found.residual_N <= TOLERANCE_N
    assert out_of_balance[1] <= TOLERANCE_N < 1e3 * TOLERANCE_N < out_of_balance[0]
    (there,) = film((25e3,))[1]
    tip = body().tip_position(there.state.positions)
    apart = body().tip_position(section().positions(found.frames, 25e3)) - tip
    assert np.linalg.norm(apart) < 0.02 * np.linalg.norm(tip)


def test_a_search_that_ends_early_says_how_far_it_is() -> None:
    loads = Loads((25e3,), (2.0, 0.0), LEANING)
    chain, start = ChainSolver(section()), section().straight(25e3)
    found = chain.solve(start, free(), loads, TOLERANCE_N, 1)
    assert (found.outcome, found.iterations) == (Outcome.ITERATION_LIMIT, 1)
    assert found.residual_N > TOLERANCE_N


def test_a_chain_that_cannot_move_is_in_equilibrium() -> None:
    start = section().straight(25e3)
    found = ChainSolver(section()).solve(start, np.zeros_like(free()), Loads((25e3,), (2.0, 0.0)), 0.0, 1)
    assert (found.outcome, found.iterations, found.residual_N) == (Outcome.CONVERGED, 0, 0.0)
    np.testing.assert_array_equal(found.frames, start)


def test_units_that_press_on_one_another_carry_in_the_chain_as_in_the_film() -> None:
    chain, law, loads = framed_section(), LAW, Loads((30e3,), (5.0, 0.0))
    film = chain.body

    def film_tip(films: FilmContactLaw | None) -> Array:
        clamp, contact = Clamp.of_base(film), None if films is None else SelfContact(film, films)
        newton = NewtonSolver(FilmPotential(film), clamp.mask(film.nodes))
        solver = EquilibriumSolver(newton, clamp, NewtonOptions(), contact)
        begin = solver.solve(SoftState.drawn(film, Pose()), Pose(), Loads((1e3,), (0.0, 0.0)))
        return film.tip_position(solver.follow(begin, Pose(), loads).state.positions)

    solver, frames = ChainSolver(chain), chain.straight(30e3)
    able = np.arange(len(frames)) > 0
    for pull in (1.0, 2.0, 3.0, 4.0, 5.0):
        asked = replace(loads, cable_tension_N=(pull, 0.0))
        found = solver.solve(frames, able, asked, TOLERANCE_N, 40)
        assert found.outcome is Outcome.CONVERGED
        frames = found.frames
    tip = film.tip_position(chain.positions(frames, 30e3))
    pressed, apart = film_tip(law), film_tip(None)
    # 0.4 % of the length, as without contact; what contact does is five times that
    assert np.linalg.norm(tip - pressed) < 0.15e-3 < 0.75e-3 < np.linalg.norm(apart - pressed)


def test_a_model_of_a_refined_mesh_is_nearer_to_its_film_than_that_of_the_coarse_one() -> None:
    scenario = load_scenario("ur5e_hexagon_arm")
    robot = file_of(scenario, "units")
    cables = tuple(replace(cable, units=(1, 2)) for cable in robot.cables)
    stack = replace(robot.stack, units=2, mesh="drawn", refine_holes=0, neck=None)
    small = replace(robot, stack=stack, cables=cables)
    coarse, fine = (build_soft_body(small, scenario.model, finer=finer) for finer in (0, 1))
    effort = Effort(levels=8, samples=12, intervals=4)
    models = [build_model(*of, effort=effort) for of in ((coarse, 33e3), (fine, 33e3, None, coarse))]
    assert models[1].samples < 0.4 * models[0].samples  # the others were sampled on the coarse mesh alone
    assert models[1].failures == 0
    assert models[1].tip_error < 0.03
    loads, clamp = Loads((25e3,), (0.0, 0.0), (1.0, 0.0, 9.0)), Clamp.of_base(fine)
    solver = EquilibriumSolver(
        NewtonSolver(FilmPotential(fine), clamp.mask(fine.nodes)), clamp, NewtonOptions()
    )
    begin = solver.solve(SoftState.drawn(fine, Pose()), Pose(), Loads((1e3,), (0.0, 0.0)))
    film = fine.tip_position(solver.follow(begin, Pose(), loads).state.positions)
    off = []
    for film_body, model in zip((coarse, fine), models, strict=True):
        chain = ChainSolver(SectionBody(film_body, model))
        able = np.arange(len(chain.section.frames)) > 0
        found = chain.solve(chain.section.straight(25e3), able, loads, TOLERANCE_N, 60)
        assert found.outcome is Outcome.CONVERGED
        off.append(float(np.linalg.norm(found.frames[-1, 0] - film)))
    assert 2.0 * off[1] < off[0]
