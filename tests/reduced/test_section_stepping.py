"""Frames and film in motion: rigid motions are recognised, what held frames are supplied with is summed."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.reduced.section_model import RingFrames, carried, points_of
from cosim.reduced.sections.figures import center_and_inertia, figures_of, supplied_wrench
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.chain_step import ChainState
from cosim.reduced.solve.clamp import FrameClamp, rates_from_nodes, rigid_motion, twists
from cosim.reduced.solve.time_step import ChainStepper
from cosim.soft.body.loads import Loads
from cosim.soft.solve.step_scheme import StepOptions
from tests.small_section import section
from tests.soft.bodies import hexagon_arm

SHIFT, TURN = np.array([0.3, -0.7, 0.2]), np.array([1.1, 0.4, -0.9])
ROUNDING = 1e-12


def velocity(points: Array, origin: Array) -> Array:
    """Return the velocity (n, 3) [m/s] of points of a rigid body, given at an origin."""
    return SHIFT + np.cross(TURN, points - origin)


def test_the_motion_of_some_nodes_is_told_at_the_frame_s_origin() -> None:
    random = np.random.default_rng(2)
    arm = random.normal(size=(7, 3)) + 2.0  # the origin is beside them
    assert rigid_motion(arm, velocity(arm, np.zeros(3))) == pytest.approx([*SHIFT, *TURN], abs=ROUNDING)
    # what no rigid motion explains is left out: breathing, and a warp that turns nothing
    around = arm - arm.mean(axis=0)
    warped = velocity(arm, np.zeros(3)) + 0.3 * around
    assert rigid_motion(arm, warped) == pytest.approx([*SHIFT, *TURN], abs=ROUNDING)


def test_frames_move_with_their_rings_and_the_flange_rests() -> None:
    body = hexagon_arm(3)
    layout = RingFrames.of(body)
    pose = Pose(rotation_from_vector(np.array([0.5, -0.2, 0.8])), np.array([0.3, 0.1, 0.7]))
    x, frames = pose.apply(body.positions), carried(layout.drawn, pose)
    rates = rates_from_nodes(layout, frames, velocity(x, pose.translation))
    assert not rates[0].any()
    for frame, rate in zip(frames[1:], rates[1:], strict=True):
        assert rate[0] == pytest.approx(velocity(frame[0], pose.translation), abs=ROUNDING)
        assert rate[1:] == pytest.approx(np.cross(TURN, frame[1:]), abs=ROUNDING)
    motion = twists(frames, rates)
    assert motion[1:, :3] == pytest.approx(rates[1:, 0])
    assert motion[1:, 3:] == pytest.approx(np.tile(TURN, (len(frames) - 1, 1)), abs=ROUNDING)


def test_held_frames_hand_force_and_moment_on_to_the_flange() -> None:
    places = ([0.1, 0.0, 0.5], [0.1, 0.0, 0.4], [0.0, 0.0, 0.0])
    frames = np.array([points_of(Pose(np.eye(3), np.array(place))) for place in places])
    supplied = np.array([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3], [4.0, -1.0, 0.5, 0.0, 0.0, 0.1], [9.0] * 6])
    free = np.array([False, False, True])
    wrench = supplied_wrench(figures_of(frames, free, np.zeros((3, 4, 4)), supplied))
    # what the chain exerts is minus what it is supplied with; the second frame hangs 0.1 m below the flange
    assert wrench.force == pytest.approx([-5.0, -1.0, -3.5])
    assert wrench.torque == pytest.approx([-0.1 + 0.1, -0.2 + 0.4, -0.4])


def test_frames_weigh_as_the_points_that_ride_on_them() -> None:
    random = np.random.default_rng(3)
    turns = [rotation_from_vector(v) for v in random.normal(size=(3, 3))]
    poses = [Pose(turn, place) for turn, place in zip(turns, random.normal(size=(3, 3)), strict=True)]
    frames = np.array([points_of(pose) for pose in poses])
    weights, local = random.uniform(0.1, 1.0, (3, 5)), random.normal(size=(3, 5, 3))
    point = np.concatenate([np.ones((3, 5, 1)), local], axis=2)
    mass = np.einsum("fk,fka,fkb->fab", weights, point, point)
    center, inertia = center_and_inertia(figures_of(frames, np.ones(3, dtype=bool), mass, np.zeros((3, 6))))
    places = np.concatenate([pose.apply(p) for pose, p in zip(poses, local, strict=True)])
    own = MassProperties.of(weights.ravel(), places)
    assert center == pytest.approx(own.center, abs=ROUNDING)
    assert inertia == pytest.approx(own.inertia, abs=1e-11)


def test_a_step_ends_at_the_speed_at_which_its_frames_have_moved() -> None:
    solver, base = ChainSolver(section()), FrameClamp.of_base(section())
    step_s, begin = 1e-3, ChainState.at_rest(section().straight(25e3), 25e3)
    loads = Loads((25e3,), (2.0, 0.0), (4.0, 0.0, -9.81))
    euler, bdf2 = (ChainStepper(solver, StepOptions(name)) for name in ("implicit_euler", "bdf2"))
    first = euler.step(euler.task(begin, base, step_s), loads)
    moved = first.frames - begin.frames
    assert np.abs(moved[1:, 0]).max() > 1e-7
    assert first.chain.rates == pytest.approx(moved / step_s, abs=1e-9)
    second = bdf2.step(bdf2.task(first.chain, base, step_s), loads)
    wanted = (3.0 * second.frames - 4.0 * first.frames + begin.frames) / (2.0 * step_s)
    assert second.chain.rates == pytest.approx(wanted, abs=1e-9)
    # and its figures are those of where it ends
    own = figures_of(second.frames, base.free, section().mass, second.gradient)
    assert second.figures == pytest.approx(own, abs=ROUNDING)


def test_a_volume_is_that_at_its_own_pressure() -> None:
    solver, frames = ChainSolver(section()), section().straight(25e3)
    low, high = (float(section().volumes(frames[None], np.array([p]))[0, 0]) for p in (10e3, 35e3))
    assert high > 1.001 * low
    for pressure_Pa, volume in ((10e3, low), (35e3, high), (10e3, low)):
        assert solver.volume(frames, pressure_Pa)[0] == pytest.approx(volume, rel=1e-9)
