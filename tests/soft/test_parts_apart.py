"""Bodies side by side that nothing couples, such as a gripper's fingers, are solved one by one in a step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.errors import ConvergenceError, InputError
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.film.film import FilmPotential
from cosim.soft.linear.pattern import BlockPattern, uncoupled_ranges
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.time_step import Stepper
from tests.soft.bodies import FILM, HANGING, Held, held, hexagon_arm, hung, no_load
from tests.soft.contacts import half_space
from tests.soft.test_attachment import arm_and_fingers

FINGERS, STEP_S, TICKS = 3, 0.002, 12
TOLERANCE_N = 2e-6  # below it the turns of the printed ring's beams, sought to 3e-9, let the forces jump
TIGHT = NewtonOptions(reuse_max=20, start_tolerance_N=TOLERANCE_N)
GAS_Pa = (5e3,) * FINGERS


def finger() -> SoftBody:
    """Return a finger of two films that wrinkle, with cables and a printed ring."""
    body = hexagon_arm(2)
    lower = np.arange(len(body.triangles)) < len(body.triangles) // 2
    groups = {"lower": np.flatnonzero(lower), "upper": np.flatnonzero(~lower)}
    wrinkling = replace(FILM, law="wrinkling")
    films = {"lower": wrinkling, "upper": replace(wrinkling, thickness_m=0.2e-3)}
    made = SoftBody.from_arrays(
        body.positions, body.triangles, films, face_groups=groups, wrinkle_panel_m=0.02,
        hinge_nodes=body.hinges.nodes, hinge_stiffness=body.hinges.stiffness, fold_barrier_rad=0.02 * np.pi,
        caps=body.caps, cables=body.cables, node_mass=body.node_mass, base=body.base, tip=body.tip,
        rings=body.rings,
    )  # fmt: skip
    ring = body.rings["unit_1.outer"][None]
    return made.with_elements(BeamRings.from_shape(body.positions, ring, RectangularSection(1e-3, 1e-3, 2e9)))


def gripper() -> SoftBody:
    """Return three such fingers."""
    return copies(finger(), around_axis(FINGERS, 0.1, 0.3))


def bounds_of(body: SoftBody) -> list[int]:
    """Return where ranges of a body's nodes begin that nothing couples, and their number."""
    return list(uncoupled_ranges(FilmPotential(body).pattern))


def test_fingers_are_apart_and_what_an_arm_joins_is_not() -> None:
    own = finger().nodes
    assert bounds_of(finger()) == [0, own]
    assert bounds_of(gripper()) == [0, own, 2 * own, 3 * own]
    joined = arm_and_fingers()
    assert bounds_of(joined) == [0, joined.nodes]


def test_lone_nodes_belong_to_a_neighbour_and_interleaved_bodies_are_one() -> None:
    def found(pairs: list[tuple[int, int]]) -> list[int]:
        return list(uncoupled_ranges(BlockPattern.from_elements(8, [np.array(pairs, np.int64)])))

    assert found([(1, 2), (2, 3), (5, 6)]) == [0, 5, 8]
    assert found([(0, 4), (1, 3), (5, 7)]) == [0, 5, 8]
    assert found([(0, 2), (1, 3), (2, 4), (3, 5)]) == [0, 8]


def test_plates_and_frames_are_summed_as_by_themselves() -> None:
    body = arm_and_fingers()
    frames = tuple(element for element in body.elements if isinstance(element, FrameRings))
    assert any(frame.leads_on for frame in frames)
    x = body.positions + 1e-4 * np.random.default_rng(3).standard_normal(body.positions.shape)
    whole, system = np.zeros_like(x), FilmPotential(body)
    assert system.complete
    blocks, loads = np.zeros_like(system.blocks), no_load(body)
    energy = sum(frame.add(x, system.pattern.slots(frame.coupled), whole, blocks) for frame in frames)
    stiffer = replace(
        body,
        elements=tuple(
            replace(each, stiffness_N_m=2.0 * each.stiffness_N_m) if each in frames else each
            for each in body.elements
        ),
    )
    twice = FilmPotential(stiffer)
    share, memory = system.losses_at(x, loads), body.first_memory()
    more = twice.evaluate(x, loads, share, memory) - system.evaluate(x, loads, share, memory)
    assert more == pytest.approx(energy, rel=1e-9)
    size = np.abs(whole).max(), np.abs(blocks).max()
    np.testing.assert_allclose(twice.gradient - system.gradient, whole, atol=1e-12 * size[0])
    np.testing.assert_allclose(twice.blocks - system.blocks, blocks, atol=1e-12 * size[1])


def stepper(arm: Held, newton: NewtonOptions = TIGHT) -> Stepper:
    """Return what takes steps of it, solved far beyond what a run asks for."""
    return Stepper(arm.newton, arm.clamp, StepOptions("bdf2", TOLERANCE_N, newton=newton))


@cache
def at_rest() -> SoftState:
    """Return the gripper hanging under a little gas."""
    return hung(held(gripper()), pressure_Pa=GAS_Pa).state


@dataclass(frozen=True)
class Pressed:
    """Where steps have ended, how, and the wrench (6,) of the last one."""

    state: SoftState
    results: list[NewtonResult]
    wrench: Array


def pressed(arm: Held, move: Stepper, state: SoftState, ticks: range) -> Pressed:
    """Return how a gripper fares in some steps: a plane pushes the first finger, gas swells the second."""
    surface = ContactSurface.of(arm.body, arm.film.pattern)
    points, across = surface.points(at_rest().positions), np.array([-1.0, 0.0, 0.0])
    nearest, results, wrench = float((points @ across).min()), [], np.zeros(6)
    for k in ticks:
        # the first finger stands out towards +x: the plane comes from there
        plane = half_space(surface, across, nearest + 4e-5 * (k + 1), ContactLaw(), 0.02, points)
        flange = Pose(HANGING.rotation, HANGING.translation + np.array([0.0, 2e-7 * k * k, 0.0]))
        acting = no_load(arm.body, pressure_Pa=(5e3, 5e3 + 10.0 * k, 5e3), contact=plane)
        state, result = move.step(state, flange, acting, STEP_S, flange)
        results.append(result)
        found = arm.clamp.wrench(arm.film.gradient, state.positions, flange)
        wrench = np.concatenate([found.force, found.torque])
    return Pressed(state, results, wrench)


def test_factors_of_different_steps_are_part_of_the_state() -> None:
    arm = held(gripper())
    move = stepper(arm)
    state = pressed(arm, move, at_rest(), range(TICKS // 2)).state
    saved = arm.newton.state
    assert saved.key is not None
    expected = pressed(arm, move, state, range(TICKS // 2, TICKS)).state
    other = held(gripper())
    other.newton.state = saved
    found = pressed(other, stepper(other), state, range(TICKS // 2, TICKS)).state
    np.testing.assert_array_equal(found.positions, expected.positions)
    with pytest.raises(InputError):
        held(finger()).newton.state = saved


@pytest.mark.parametrize("bad", [0, 1, 2])
def test_a_finger_that_fails_is_named(bad: int) -> None:
    arm = held(gripper())
    strict = replace(TIGHT, iterations_max=2)
    move = Stepper(arm.newton, arm.clamp, StepOptions("bdf2", newton=strict))
    state = hung(arm).state
    gas = tuple(1e6 if k == bad else 0.0 for k in range(FINGERS))
    with pytest.raises(ConvergenceError, match=f"copy_{bad + 1}/" if bad else "of (?!copy_2|copy_3)"):
        move.step(state, HANGING, no_load(arm.body, pressure_Pa=gas), 0.02, HANGING)
