"""Fingers fold: the film is followed to where its rims meet, and its knee is in the samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.reduced.fit.sampling import Sampler, folded_strains, straight_strains
from cosim.reduced.sections.ring_frames import RingFrames, frames_from_strains, strains
from cosim.soft.body.loads import Loads
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.self_contact import SelfContact
from cosim.soft.solve.state import Clamp, SoftState
from tests.small_section import LAW

MIDDLE, BEND = 1, 0.34  # section between the two outer rings; 20 degrees


def test_a_finger_is_followed_until_its_sides_press() -> None:
    scenario = load_scenario("gripper_lifts_roll")
    robot = file_of(scenario, "units")
    cables = tuple(replace(cable, units=(1, 2)) for cable in robot.cables)
    stack = replace(robot.stack, units=2)
    finger = replace(robot, stack=stack, cables=cables, copies=None, palm=None)
    body = build_soft_body(finger, scenario.model)
    frames, clamp = RingFrames.of(body), Clamp.of_base(body)
    newton = NewtonSolver(SoftSystem(body), clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, NewtonOptions(), SelfContact(body, LAW))
    still = Loads((), (0.0, 0.0), (0.0, 0.0, 0.0))
    drawn = solver.solve(SoftState.drawn(body, Pose()), Pose(), still)
    free = solver.follow(drawn, Pose(), replace(still, pressure_Pa=(40e3,)))
    at = frames.fit(free.state.positions, Pose())
    wanted = strains(at[:-1], at[1:])
    wanted[MIDDLE, 2] *= 1.0 - 0.5 * BEND
    wanted[MIDDLE, 3] = BEND
    sampler = Sampler(body, frames, LAW)
    samples = sampler.way(free, wanted)
    assert sampler.reached == [pytest.approx(1.0)]
    bend = np.array([strain[MIDDLE, 3] for _, strain, *_ in samples])
    moment = np.array([force[MIDDLE, 3] for _, _, force, *_ in samples])
    assert bend[-1] > 0.9 * BEND
    loose, pressed = moment[bend < 0.1].max() / 0.1, np.diff(moment[-2:])[0] / np.diff(bend[-2:])[0]
    assert 0.0 < loose < 0.2 < 5.0 * loose < pressed


def test_half_a_unit_turns_about_its_neck() -> None:
    random, low, high = np.random.default_rng(2), np.full(3, 0.02), np.full(3, 0.03)
    radii = np.array([0.0, 0.04, 0.04, 0.0])
    for _ in range(50):
        values = folded_strains(random, low, high, radii)
        frames = frames_from_strains(np.vstack([np.zeros(3), np.eye(3)]), values)
        assert np.isfinite(frames).all()
        bend = np.hypot(values[0, 3], values[0, 4])
        # across the plane of bending, the rim of the first section moves as it does about the flange
        across = (values[0, 0] * values[0, 4] - values[0, 1] * values[0, 3]) / max(bend, 1e-12)
        assert abs(across - 0.45 * values[0, 2] * bend) < 0.25 * values[0, 2] * bend + 1.5e-3
    assert straight_strains(low, high, 0.5)[:, 2].tolist() == [0.025] * 3
