"""Flange poses and motions of a scenario."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Pose
from cosim.config.schema.phase import FlangePoseTable, FlangeShakeTable, FlangeTurnTable, PhaseTable
from cosim.plan.flange_motion import FlangeMotion, Shake, pose_of, rotation_from_direction

# products of a few rotation matrices: rounding of a few 1e-16
ROUNDING = 1e-14


def test_hanging_down_keeps_the_worlds_x_axis() -> None:
    pose = pose_of(FlangePoseTable((0.3, 0.0, 0.7), (0.0, 0.0, -2.0)))
    assert pose.rotation == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=ROUNDING)
    assert pose.translation.tolist() == [0.3, 0.0, 0.7]


def test_pointing_up_is_half_a_turn_about_y_from_hanging() -> None:
    assert rotation_from_direction(np.array([0.0, 0.0, 1.0])) == pytest.approx(
        np.diag([-1.0, -1.0, 1.0]), abs=ROUNDING
    )


@pytest.mark.parametrize("roll", [0.0, 0.7, -2.0])
def test_every_direction_gives_a_rotation_with_that_z_axis(roll: float) -> None:
    random = np.random.default_rng(1)
    for direction in random.normal(size=(100, 3)):
        rotation = rotation_from_direction(direction, roll)
        assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)  # 1 / (1 + c) amplifies rounding
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert rotation[:, 2] == pytest.approx(direction / np.linalg.norm(direction), abs=1e-12)


def test_the_roll_turns_right_handed_about_the_flanges_z_axis() -> None:
    plain, rolled = (rotation_from_direction(np.array([1.0, 0.0, 0.0]), roll) for roll in (0.0, 0.5))
    assert plain.T @ rolled == pytest.approx(
        np.array([[np.cos(0.5), -np.sin(0.5), 0.0], [np.sin(0.5), np.cos(0.5), 0.0], [0.0, 0.0, 1.0]]),
        abs=ROUNDING,
    )


def test_the_reference_turn_swings_the_tip_towards_x_with_the_flanges_x_axis_up() -> None:
    start = pose_of(FlangePoseTable((0.3, 0.0, 0.7), (0.0, 0.0, -1.0)))
    angle = 0.28 * np.pi
    end = FlangeMotion.relative(start, FlangeTurnTable((0.0, 3.0, 0.0), -angle), None).end
    assert end.rotation[:, 2] == pytest.approx([np.sin(angle), 0.0, -np.cos(angle)], abs=ROUNDING)
    assert end.rotation[2, 0] > 0.0  # the cables, on the flange's +x side, end on top
    assert end.translation == pytest.approx(start.translation)
    assert end.rotation == pytest.approx(rotation_from_direction(end.rotation[:, 2]), abs=ROUNDING)


def test_half_of_a_motion_done_twice_is_the_motion() -> None:
    turn, shift = FlangeTurnTable((1.0, 2.0, -0.5), 1.1), np.array([0.1, -0.2, 0.3])
    start = Pose(rotation_from_direction(np.array([0.2, 0.5, -0.3])), np.array([1.0, 2.0, 3.0]))
    once = FlangeMotion.relative(start, turn, shift).end
    half = FlangeMotion.relative(start, turn, shift).at(0.5)
    twice = FlangeMotion.relative(half, turn, shift).at(0.5)
    assert twice.rotation == pytest.approx(once.rotation, abs=ROUNDING)
    assert twice.translation == pytest.approx(once.translation, abs=ROUNDING)


def test_a_shake_begins_and_ends_at_rest_and_reaches_its_amplitude() -> None:
    shake = Shake(np.array([0.0, 0.02, 0.0]), 5.0)
    way = FlangeMotion(Pose(), np.zeros(3), np.array([0.1, 0.0, 0.0]), shake)
    fraction = np.linspace(0.0, 1.0, 2001)
    path = np.array([way.at(s).translation for s in fraction])
    np.testing.assert_allclose(path[:, 0], 0.1 * fraction, atol=1e-15)
    assert path[:, 1].max() == pytest.approx(0.02, rel=1e-4)
    assert path[:, 1].min() == pytest.approx(-0.02, rel=1e-4)
    assert np.abs(path[[0, -1], 1]).max() < 1e-15
    assert np.abs(np.diff(path[:, 1])[[0, -1]]).max() < 1e-9
    middle = path[(fraction > 0.25) & (fraction < 0.75), 1]
    assert np.count_nonzero(np.diff(np.sign(middle[middle != 0.0]))) == 5  # the zeros of 2.5 periods
    assert way.pieces >= 100


def test_a_phase_says_how_its_flange_shakes() -> None:
    shake = Shake.of(
        PhaseTable("shake", 1.5, ramp="linear", flange_shake=FlangeShakeTable((0.0, 3.0, 4.0), 0.01, 4.0))
    )
    assert shake is not None
    assert shake.amplitude == pytest.approx([0.0, 0.006, 0.008])
    assert shake.cycles == pytest.approx(6.0)  # 4 a second for 1.5 s
    assert Shake.of(PhaseTable("rest", 1.5)) is None
