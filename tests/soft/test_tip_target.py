"""Flange poses and tensions that bring the deformed tip to a target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import UnreachableError
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.flange_search import find_flange_pose
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tension_search import find_tensions, tension_slope
from cosim.soft.solve.tip_target import TargetOptions, TipTarget, shortest_turn
from tests.derivatives import differences
from tests.soft.bodies import HANGING, Held, PRESSURE_Pa, held, hexagon_arm, hung, no_load

UNITS = 5
MOST_ITERATIONS = 8


@pytest.fixture(scope="module")
def arm() -> Held:
    return held(hexagon_arm(UNITS))


@pytest.fixture(scope="module")
def begin(arm: Held) -> Equilibrium:
    return hung(arm, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=(1.0, 0.5))


def elsewhere(arm: Held, begin: Equilibrium, tilt: float, azimuth: float) -> Equilibrium:
    """Return the equilibrium with the flange tilted and shifted: its tip can be reached."""
    here = begin
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    for k in range(1, 5):
        turn = rotation_from_vector(0.25 * k * tilt * axis)
        pose = Pose(turn @ HANGING.rotation, HANGING.translation + 0.25 * k * np.array([0.05, -0.1, 0.02]))
        here = arm.equilibrium.follow(here, pose, begin.loads)
    return here


@pytest.mark.parametrize(("tilt", "azimuth"), [(0.4, 0.3), (1.0, 2.0), (1.5, -1.5)])
@pytest.mark.parametrize("kind", ["direction", "rotation", "position"])
def test_flange_pose(arm: Held, begin: Equilibrium, tilt: float, azimuth: float, kind: str) -> None:
    there = elsewhere(arm, begin, tilt, azimuth)
    tip = TipFrame.of(arm.body, there.state.positions)
    given = {"direction": {"direction": 3.0 * tip.direction}, "rotation": {"rotation": tip.rotation}}
    target = TipTarget(position=tip.position, **given.get(kind, {}))
    found = find_flange_pose(arm.equilibrium, begin, target)
    reached = TipFrame.of(arm.body, found.equilibrium.state.positions)
    assert np.linalg.norm(reached.position - tip.position) < 1e-5
    if kind != "position":
        assert np.linalg.norm(np.cross(reached.direction, tip.direction)) < 1e-4
    if kind == "rotation":
        assert reached.rotation == pytest.approx(tip.rotation, abs=2e-4)
        pose = found.equilibrium.world_from_flange
        assert pose.translation == pytest.approx(there.world_from_flange.translation, abs=1e-3)
    assert 1 <= found.iterations <= MOST_ITERATIONS
    assert found.position_error_m == pytest.approx(np.linalg.norm(reached.position - tip.position), abs=1e-12)
    assert found.equilibrium.loads == begin.loads
    assert found.equilibrium.residual_N < 1e-6


def test_convergence_to_a_target_is_fast(arm: Held, begin: Equilibrium) -> None:
    # With a wrong sign or lever in the derivative it still creeps there; the derivative shows in the speed.
    there = elsewhere(arm, begin, 0.3, 1.0)
    tip = TipFrame.of(arm.body, there.state.positions)
    target = TipTarget(position=tip.position, rotation=tip.rotation)
    tight = TargetOptions(position_tolerance_m=1e-8, angle_tolerance_rad=1e-6)
    assert find_flange_pose(arm.equilibrium, begin, target, tight).iterations <= 5


def test_one_step_leaves_an_error_of_second_order(arm: Held, begin: Equilibrium) -> None:
    # a wrong lever would leave 10 mm of a turn by 0.1 rad, a wrong sign of the sag 1 mm
    errors = []
    for tilt in (0.1, 0.05):
        turn = rotation_from_vector(np.array([0.6 * tilt, -0.8 * tilt, 0.0]))
        pose = Pose(turn @ HANGING.rotation, HANGING.translation)
        there = arm.equilibrium.follow(begin, pose, begin.loads)
        tip = TipFrame.of(arm.body, there.state.positions)
        once = TargetOptions(position_tolerance_m=0.0, iterations_max=1)
        with pytest.raises(UnreachableError) as caught:
            find_flange_pose(arm.equilibrium, begin, TipTarget(tip.position, rotation=tip.rotation), once)
        assert caught.value.closest.iterations == 1
        errors.append(caught.value.closest.position_error_m)
    assert errors[0] < 1e-3
    assert errors[1] < 0.35 * errors[0]


def test_a_target_already_met_needs_nothing(arm: Held, begin: Equilibrium) -> None:
    tip = TipFrame.of(arm.body, begin.state.positions)
    found = find_flange_pose(arm.equilibrium, begin, TipTarget(position=tip.position))
    assert found.iterations == 0
    assert found.equilibrium is begin


def test_tensions_for_a_height_and_for_a_point(arm: Held, begin: Equilibrium) -> None:
    sagging = elsewhere(arm, begin, 1.2, -np.pi / 2)  # cables end on the upper side
    loads = no_load(arm.body, pressure_Pa=(PRESSURE_Pa,), cable_tension_N=(2.5, 2.0))
    lifted = TipFrame.of(
        arm.body, arm.equilibrium.follow(sagging, sagging.world_from_flange, loads).state.positions
    )
    now = TipFrame.of(arm.body, sagging.state.positions)
    assert abs(lifted.position[2] - now.position[2]) > 1e-3
    for target in (TipTarget(height=lifted.position[2]), TipTarget(position=lifted.position)):
        found = find_tensions(arm.equilibrium, sagging, target)
        tip = TipFrame.of(arm.body, found.equilibrium.state.positions)
        assert abs(tip.position[2] - lifted.position[2]) < 1e-5
        assert found.equilibrium.world_from_flange is sagging.world_from_flange
        assert min(found.equilibrium.loads.cable_tension_N) >= 0.0
        assert found.iterations <= MOST_ITERATIONS
    assert found.equilibrium.loads.cable_tension_N == pytest.approx((2.5, 2.0), abs=0.02)


def test_by_how_much_tensions_make_good_for_a_height(arm: Held, begin: Equilibrium) -> None:
    here = elsewhere(arm, begin, 1.2, -np.pi / 2)

    def height(tension: Array) -> float:
        loads = replace(here.loads, cable_tension_N=tuple(tension.tolist()))
        there = arm.equilibrium.follow(here, here.world_from_flange, loads)
        return float(arm.body.tip_position(there.state.positions)[2])

    rise = differences(height, np.array(here.loads.cable_tension_N), 1e-2)
    target = TipTarget(height=height(np.array(here.loads.cable_tension_N)))
    # of all changes that lift the tip by a metre the smallest
    expected = np.abs(rise).max() / (rise @ rise)
    assert tension_slope(arm.equilibrium, here, target) == pytest.approx(expected, rel=1e-3)


def test_what_no_tension_reaches_is_named_with_the_closest(arm: Held, begin: Equilibrium) -> None:
    tip = TipFrame.of(arm.body, begin.state.positions)
    away = TipTarget(position=tip.position - 0.05 * np.array([0.0, 0.0, 1.0]))  # cables cannot push
    with pytest.raises(UnreachableError, match="no cable tensions of 0 to 100 N found") as caught:
        find_tensions(arm.equilibrium, begin, away, TargetOptions(iterations_max=5))
    closest = caught.value.closest
    assert closest.position_error_m == pytest.approx(0.05, abs=0.005)
    assert min(closest.equilibrium.loads.cable_tension_N) >= 0.0


def test_a_search_cut_short_is_named(arm: Held, begin: Equilibrium) -> None:
    tip = TipFrame.of(arm.body, begin.state.positions)
    far = TipTarget(position=tip.position, direction=np.array([1.0, 0.0, 0.2]))
    with pytest.raises(UnreachableError, match="no flange pose found"):
        find_flange_pose(arm.equilibrium, begin, far, TargetOptions(iterations_max=1))


def test_shortest_turn_brings_one_direction_to_the_other() -> None:
    random = np.random.default_rng(0)
    for begin, end in random.normal(size=(50, 2, 3)):
        turn = shortest_turn(begin, end)
        a, b = begin / np.linalg.norm(begin), end / np.linalg.norm(end)
        assert rotation_from_vector(turn) @ a == pytest.approx(b, abs=1e-12)
        assert np.linalg.norm(turn) == pytest.approx(np.arccos(a @ b), abs=1e-7)
    for axis in np.eye(3):
        assert not shortest_turn(axis, 2.0 * axis).any()
        assert rotation_from_vector(shortest_turn(axis, -axis)) @ axis == pytest.approx(-axis, abs=1e-12)


def test_errors_of_a_target() -> None:
    tip = TipFrame(np.array([0.1, 0.2, 0.3]), np.eye(3))
    rows, error = TipTarget(height=0.35).error(tip)
    assert rows.tolist() == [[0, 0, 1, 0, 0, 0]]
    assert error == pytest.approx([0.05])
    assert TipTarget(height=0.25).distance(tip) == pytest.approx((0.05, 0.0))
    wanted = np.array([0.0, np.sin(0.2), np.cos(0.2)])
    rows, error = TipTarget(position=np.array([0.1, 0.2, 0.4]), direction=wanted).error(tip)
    assert rows.shape == (5, 6)
    assert error == pytest.approx([0.0, 0.0, 0.1, -0.2, 0.0])
    assert TipTarget(direction=wanted).distance(tip) == pytest.approx((0.0, 0.2))
