"""How far flange and film get: bounds that decide whether contact is searched for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.config.schema.phase import FlangeShakeTable, FlangeTurnTable, PhaseTable
from cosim.kinematics.arm import Arm
from cosim.plan.commands import SoftCommand
from cosim.plan.film_reach import FlangeTravel, film_reach, flange_travel, within_reach
from cosim.plan.flange_motion import FlangeMotion, Shake
from cosim.plan.joint_planner import plan_joints
from cosim.plan.plan import Holding, PhasePlan, Plan
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.copies import Plate, attached
from tests.soft.bodies import FILM, HANGING, hexagon_arm

START = Pose(HANGING.rotation, np.array([0.4, 0.0, 0.6]))
JERK_PEAK = 10.0 / np.sqrt(3.0)  # largest |d2s/du2| of the minimum-jerk polynomial
SAMPLES = 60


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(find_arm("ur5e"))


def travel(
    arm: Arm, phase: PhaseTable, turn: FlangeTurnTable | None, shift: Array | None, lever_m: float
) -> FlangeTravel:
    """Return the flange's travel in one phase from a pose over the table."""
    way = FlangeMotion.relative(START, turn, shift, Shake.of(phase))
    idle = SoftCommand((), (), (), ())
    nothing = Holding(np.zeros(0, np.int64), np.zeros((0, 3), dtype=bool))
    (path,) = plan_joints(arm, START, [way], str)
    planned = PhasePlan(phase, path, idle, idle, (), nothing, None, way.end)
    return flange_travel(arm, Plan(START, path.first, idle, (0.0, 0.0, 0.0), (planned,)), lever_m)


def test_a_shift_asks_for_its_minimum_jerk_peak_and_is_sampled_closely(arm: Arm) -> None:
    phase = PhaseTable("move", 0.5)
    found = travel(arm, phase, None, np.array([0.0, 0.1, 0.0]), 0.3)
    assert found.acceleration_m_s2 == pytest.approx(0.1 * JERK_PEAK / 0.5**2, rel=0.01)
    assert found.positions[[0, -1]] == pytest.approx(
        START.translation + np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]), abs=1e-6
    )
    # fastest in the middle, 15/8 of the mean speed
    assert found.gap_m == pytest.approx(0.1 * 15.0 / 8.0 / (SAMPLES - 1), rel=0.01)


def test_a_lever_along_the_flange_s_axis_adds_to_the_shift(arm: Arm) -> None:
    # hanging, a small turn about y moves the lever's end towards -x, by as much as the flange goes there
    angle, lever = 0.05, 0.4
    turn, shift = FlangeTurnTable((0.0, 1.0, 0.0), angle), np.array([-lever * angle, 0.0, 0.0])
    found = travel(arm, PhaseTable("move", 0.5), turn, shift, lever)
    assert found.acceleration_m_s2 == pytest.approx(2.0 * lever * angle * JERK_PEAK / 0.5**2, rel=0.02)


def test_shaking_counts_with_its_stroke_and_its_acceleration(arm: Arm) -> None:
    shake = FlangeShakeTable((0.0, 0.0, 1.0), 0.01, 4.0)
    found = travel(arm, PhaseTable("shake", 1.0, ramp="linear", flange_shake=shake), None, None, 0.2)
    assert found.gap_m >= 0.02
    assert found.acceleration_m_s2 == pytest.approx(0.01 * (8.0 * np.pi) ** 2)


def test_reach_is_counted_from_the_flange_and_grows_with_pressure() -> None:
    body, away = hexagon_arm(2), np.array([0.2, 0.1, 0.0])
    shifted = replace(body, positions=body.positions + away)
    bases = [float(np.linalg.norm(x.positions[x.base], axis=1).max()) for x in (body, shifted)]
    assert film_reach(shifted, 0.0) - film_reach(body, 0.0) == pytest.approx(bases[1] - bases[0])
    way = film_reach(body, 0.0) - bases[0]
    # p D / (E t), four times as much as a thin tube's
    strain = 4.0 * 50e3 * 0.1 / (FILM.young_modulus_Pa * FILM.thickness_m)
    assert film_reach(body, 50e3) - film_reach(body, 0.0) == pytest.approx(strain / 1.05 * way, rel=0.01)


def test_a_plate_leads_from_one_film_to_the_next() -> None:
    turned = Pose(rotation_from_vector(np.array([0.3, 0.0, 0.0])), np.array([0.0, 0.0, 0.012]))
    body = attached(hexagon_arm(2), "arm", hexagon_arm(1), "finger", turned, Plate(0.01, 1e6))
    farthest = float(np.linalg.norm(body.positions, axis=1).max())
    assert film_reach(hexagon_arm(2), 0.0) < film_reach(body, 0.0) < film_reach(hexagon_arm(2), 0.0) + 0.12
    assert film_reach(body, 0.0) > farthest


@pytest.mark.parametrize(("height_m", "names"), [(0.279, ("floor",)), (0.281, ())])
def test_what_is_near_the_way_is_within_reach(height_m: float, names: tuple[str, ...]) -> None:
    # reach, half a gap between samples, and 5 cm beside the planned way
    scene = RigidScene(SceneDescription(find_arm("ur5e")))
    way = FlangeTravel(np.array([[0.5, 0.0, height_m]]), 0.06, 0.0)
    assert within_reach(scene, way, 0.2) == names
