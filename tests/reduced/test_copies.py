"""Copies of a stack side by side on one flange: each is the one chain, where it stands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.coupling.robots.beam_robot import BeamRobot
from cosim.errors import InputError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.clamp import FrameClamp
from cosim.reduced.solve.tangent import ChainPoint, ChainTangent, HeldLengths, whole_tangent
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.step_scheme import StepOptions
from tests.small_section import body, section

PRESSURE_Pa, COUNT, TOLERANCE_N = 25e3, 3, 1e-9
POSES = around_axis(COUNT, 0.08, 0.3, -1.1, 0.01)
GRAVITY = np.array([2.0, -1.0, 9.0])
PULLS = ((2.0, 0.0), (0.0, 0.5), (1.0, 1.0))


@cache
def gripper() -> SectionBody:
    """Return three copies that share the model of one."""
    return SectionBody(copies(body(), POSES), section().model)


def solved(chain: SectionBody, loads: Loads) -> tuple[Array, Array]:
    """Return the frames in equilibrium with the flange held, and the gradient there."""
    clamp = FrameClamp.of_base(chain)
    found = ChainSolver(chain).solve(chain.straight(PRESSURE_Pa), clamp.free, loads, TOLERANCE_N, 60)
    assert found.outcome is Outcome.CONVERGED
    return found.frames, found.gradient


def together() -> Loads:
    """Return what acts on all copies: every one has tensions of its own."""
    return Loads((PRESSURE_Pa,) * COUNT, tuple(t for pulls in PULLS for t in pulls), tuple(GRAVITY.tolist()))


def alone(copy: int) -> Loads:
    """Return the same for one of them, seen from where it stands."""
    leaning = POSES[copy].rotation.T @ GRAVITY
    return Loads((PRESSURE_Pa,), PULLS[copy], tuple(leaning.tolist()))


def test_every_copy_takes_the_shape_that_it_would_take_alone() -> None:
    frames, _ = solved(gripper(), together())
    films = np.split(gripper().positions(frames, PRESSURE_Pa), COUNT)
    volumes = gripper().volumes(frames[None], np.array([PRESSURE_Pa]))[0]
    for copy, chain in enumerate(gripper().frames.chains):
        one, _ = solved(section(), alone(copy))
        assert frames[chain, 0] == pytest.approx(POSES[copy].apply(one[:, 0]), abs=1e-9)
        assert frames[chain, 1:] == pytest.approx(one[:, 1:] @ POSES[copy].rotation.T, abs=1e-7)
        own = section().positions(one, PRESSURE_Pa)
        assert films[copy] == pytest.approx(POSES[copy].apply(own), abs=1e-8)
        assert volumes[copy] == pytest.approx(section().volumes(one[None], np.array([PRESSURE_Pa]))[0, 0])


def test_a_flange_bears_what_its_copies_weigh() -> None:
    chain = BeamRobot(gripper(), Pose(), NewtonOptions(tolerance_N=1e-7), StepOptions())
    found = chain.start(Pose(), replace(together(), cable_tension_N=(0.0,) * 6))
    weight = gripper().mass_kg * GRAVITY
    assert gripper().mass_kg == pytest.approx(COUNT * section().mass_kg)
    assert found.wrench.force == pytest.approx(weight, abs=1e-5)
    chain.commit(found)
    center = chain.mass_properties().center
    assert found.wrench.torque == pytest.approx(np.cross(center, weight), abs=1e-4)


def test_a_turned_flange_takes_all_copies_along() -> None:
    turn = Pose(rotation_from_vector(np.array([0.3, 0.2, -0.4])), np.array([0.1, 0.2, 0.3]))
    chain = BeamRobot(gripper(), Pose(), NewtonOptions(tolerance_N=1e-7), StepOptions())
    here = chain.start(Pose(), together())
    leaning = tuple((turn.rotation @ GRAVITY).tolist())
    there = chain.follow(here, turn, replace(together(), gravity=leaning))
    assert there.state.positions == pytest.approx(turn.apply(here.state.positions), abs=1e-6)


def test_copies_have_one_pressure() -> None:
    assert gripper().pressure(together()) == PRESSURE_Pa
    with pytest.raises(InputError, match="pressures of copies are 2000 to 3000 Pa"):
        gripper().pressure(Loads((2e3, 3e3, 3e3)))


@pytest.mark.parametrize("commanded", [False, True])
def test_a_factorised_tangent_solves_with_the_whole_of_it(commanded: bool) -> None:
    chain, solver = gripper(), ChainSolver(gripper())
    frames, _ = solved(chain, together())
    free = FrameClamp.of_base(chain).free.copy()
    free[5] = False  # in the middle of a copy
    random, moves = np.random.default_rng(0), np.repeat(free, 6)
    gradient = random.normal(size=(2, 6 * len(frames))) * moves
    lengths = HeldLengths(gradient, np.array([300.0, 0.0])) if commanded else None
    at = ChainPoint(frames, together(), PRESSURE_Pa, lengths)
    load = random.normal(size=(4, len(frames), 6))
    moved = ChainTangent(solver, at, free).solve(load)
    assert np.abs(moved[:, ~free]).max() == 0.0
    whole = whole_tangent(solver, at)[np.ix_(moves, moves)]
    expected = np.linalg.solve(whole, load.reshape(4, -1)[:, moves].T).T
    scale = float(np.abs(expected).max())
    np.testing.assert_allclose(moved.reshape(4, -1)[:, moves], expected, atol=1e-9 * scale)
