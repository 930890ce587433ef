"""A soft body on the tip of another one, joined by a stiff plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import Plate, around_axis, attached, copies
from cosim.soft.body.loads import Loads
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import dihedral_angle
from cosim.soft.solve.state import SoftState
from tests.derivatives import RELATIVE, assembled, derivative_errors
from tests.soft.bodies import HANGING, held, hexagon_arm, no_load, random_rotation

ON_TOP = Pose(np.eye(3), np.array([0.0, 0.0, 0.002 * 2 + 0.008]))
PLATE = Plate(mass_kg=0.05, stiffness_N_m=1e6)


def arm_and_fingers(plate: Plate = PLATE) -> SoftBody:
    """Return an arm of two units with two one-unit fingers on its tip."""
    fingers = copies(hexagon_arm(1, node_mass=1e-4), around_axis(2, 0.06, 0.4))
    return attached(hexagon_arm(2), "arm", fingers, "gripper", ON_TOP, plate)


def gradient_of(body: SoftBody, x: Array, loads: Loads) -> Array:
    system = FilmPotential(body)
    tension = system.losses_at(x, loads)
    system.evaluate(x, loads, tension, dihedral_angle(x, body.hinges.nodes))
    return system.gradient.copy()


def test_names_masses_and_ends() -> None:
    body, arm = arm_and_fingers(), hexagon_arm(2)
    assert [part.name for part in body.chambers] == ["arm", "gripper/copy_1", "gripper/copy_2"]
    np.testing.assert_array_equal(body.tip, arm.tip)
    np.testing.assert_array_equal(body.base, arm.base)
    finger = hexagon_arm(1).nodes
    np.testing.assert_array_equal(
        body.rings["gripper/copy_2/unit_1.hole"], arm.rings["unit_1.hole"] + arm.nodes + finger
    )
    assert body.mass_kg == pytest.approx(arm.mass_kg + 2 * finger * 1e-4 + 0.05, rel=1e-12)
    assert body.plates[0].rings.shape == (1, 6 + 2 * 6)


def test_each_part_feels_what_it_does_alone() -> None:
    # in the drawn shape of the plate its frame rests, so nothing else acts between the parts
    body, arm, finger = arm_and_fingers(), hexagon_arm(2), hexagon_arm(1)
    poses = [ON_TOP @ pose for pose in around_axis(2, 0.06, 0.4)]
    x = np.concatenate([arm.positions, *(pose.apply(finger.positions) for pose in poses)])
    weightless = (0.0, 0.0, 0.0)
    whole = gradient_of(body, x, Loads((3e4, 1e4, 2e4), (5.0, 7.0), weightless))
    alone = [gradient_of(arm, arm.positions, Loads((3e4,), (5.0, 7.0), weightless))]
    for pose, pressure in zip(poses, (1e4, 2e4), strict=True):
        turned = gradient_of(finger, finger.positions, Loads((pressure,), (), weightless)) @ pose.rotation.T
        alone.append(turned)
    np.testing.assert_allclose(whole, np.concatenate(alone), atol=1e-9 * np.abs(whole).max())


def test_the_plate_keeps_its_shape_as_well_as_it_is_stiff() -> None:
    changes = []
    for stiffness in (1e6, 1e7):
        body = arm_and_fingers(replace(PLATE, stiffness_N_m=stiffness))
        solved, drawn = held(body), SoftState.drawn(body, HANGING)
        hung = solved.equilibrium.solve(drawn, HANGING, no_load(body))
        found = solved.equilibrium.follow(
            hung, HANGING, no_load(body, pressure_Pa=(2e4,) * len(body.gas_chambers))
        )
        assert found.wrench.force == pytest.approx([0.0, 0.0, -9.81 * body.mass_kg], abs=1e-4)
        x, y = (points[body.plates[0].rings[0]] for points in (body.positions, found.state.positions))
        spans = [np.linalg.norm(z[:, None] - z[None], axis=2) for z in (x, y)]
        changes.append(float(np.abs(spans[1] - spans[0]).max()))
    assert changes[0] < 3e-4  # film pulls at the hole rings with up to a hundred newtons a node
    assert changes[1] < 0.25 * changes[0]  # less than 10 times: the stiffer plate holds more of the film


def test_derivatives_of_a_plate_that_is_not_flat() -> None:
    random = np.random.default_rng(4)
    drawn = 0.03 * random.normal(size=(9, 3)) * (1.0, 1.0, 0.2)
    frames = FrameRings.from_shape(drawn, np.arange(9)[None], 1e4)
    evaluate = assembled(frames.rings, frames.add, 9)
    x = drawn + 2e-3 * random.normal(size=drawn.shape)
    assert max(derivative_errors(evaluate, x, 1e-5)) < RELATIVE
    energy, gradient, _ = evaluate(np.ascontiguousarray(drawn @ random_rotation(1).T + 0.1))
    assert energy < 1e-25
    assert np.abs(gradient).max() < 1e-10


def test_a_plate_whose_chords_leave_it_a_shear_is_refused() -> None:
    # two layers whose chords all stay within a layer: nothing resists one sliding over the other
    angle = 2.0 * np.pi / 6.0 * np.arange(6)
    flat = 0.03 * np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], axis=1)
    flat[::2, 2] = 0.01
    with pytest.raises(MeshError, match="shear"):
        FrameRings.from_shape(flat, np.arange(6)[None], 1e4)


def test_parts_that_do_not_match_are_refused() -> None:
    other = hexagon_arm(1, closed=False)
    with pytest.raises(MeshError, match="gripper cannot be attached: ends closed"):
        attached(hexagon_arm(2), "arm", other, "gripper", ON_TOP, PLATE)
