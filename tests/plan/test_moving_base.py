"""Arms on rails and turntables: where they are, how spare or prescribed joints keep limits and clearance."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.arms import find_arm, placed_arm
from cosim.build.engine_agreement import check_engines_agree
from cosim.build.simulation import build
from cosim.config.arm_table import BaseTable, RailTable, TurntableTable
from cosim.errors import InputError, ScenarioError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import follow, solve
from cosim.plan.flange_motion import rotation_from_direction
from cosim.rigid.build.description import SceneDescription, ServoGains
from cosim.rigid.scene.scene import RigidScene
from tests.config.arm_texts import SIX_JOINTS_MJCF

PLACE, CEILING = (0.1, -0.2, 1.5), (0.0, 1.0, 0.0, 0.0)
ALONG, ACROSS = (
    RailTable((0.0, 2.0, 0.0), (0.0, 2.5), 1.0),
    RailTable((1.0, 0.0, 1.0), (-0.5, 0.5), 1.0, name="lift"),
)
TABLE = TurntableTable((-3.0, 3.0), 1.0, (0.0, 0.0, 1.0), (0.5, 0.0, 0.0))
TILTED = TurntableTable((-1.0, 1.0), 1.0, (0.0, 3.0, 0.0), (0.2, 0.0, 0.3), name="tilt")
RAIL = {"rail": [{"axis": [0.0, 1.0, 0.0], "range_m": [-0.1, 2.0], "speed_m_s": 1.0}]}
DOWN = rotation_from_direction(np.array([0.0, 0.0, -1.0]))


def carried(flange: Pose, along_m: float, across_m: float, angle: float, tilt: float) -> Pose:
    """Return where a flange is once all has moved: each table turns about its axis at zero, last first."""
    for turned, axis, center in ((tilt, 1, TILTED.center_m), (angle, 2, TABLE.center_m)):
        turn, point = rotation_from_vector(turned * np.eye(3)[axis]), np.array(center)
        flange = Pose(turn @ flange.rotation, point + turn @ (flange.translation - point))
    shift = along_m * np.array([0.0, 1.0, 0.0]) + across_m * np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    return Pose(flange.rotation, flange.translation + shift)


@pytest.mark.parametrize("robot", ["ur5e", "six.xml"])
def test_rails_and_turntables_carry_the_arm_in_both_engines(robot: str, tmp_path: Path) -> None:
    (tmp_path / "six.xml").write_text(SIX_JOINTS_MJCF)
    robot = str(tmp_path / robot) if robot.endswith("xml") else robot
    base = BaseTable(PLACE, CEILING, (ALONG, ACROSS), (TABLE, TILTED))
    file, fixed = placed_arm(robot, base), Arm(placed_arm(robot, BaseTable(PLACE, CEILING)))
    arm, scene = Arm(file), RigidScene(SceneDescription(file))
    assert arm.joint_names == ("rail", "lift", "turntable", "tilt", *fixed.joint_names)
    assert arm.home[:4].tolist() == [1.25, 0.0, 0.0, 0.0]
    check_engines_agree(scene, arm, file.armature)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(*arm.drawn_from)
        found, expected = arm.forward(q), carried(fixed.forward(q[4:]), *q[:4].tolist())
        np.testing.assert_allclose(found.translation, expected.translation, atol=1e-12)
        np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-12)
    # rails feel the mass of all that they carry, the root link's too, and the rotor's 0.1 kg
    masses = [float(mass.get("value", "0")) for mass in ElementTree.fromstring(file.urdf).iter("mass")]
    assert masses.count(50.0) == 4
    assert scene.dynamics.at(q).mass_matrix[0, 0] == pytest.approx(sum(masses) + 0.1, rel=1e-9)


def test_the_file_of_an_arm_may_have_a_rail_and_keeps_its_own_servos(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(
        'file = "six.xml"\nhome = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]\n'
        "servos.stiffness = [7.0, 7.0, 7.0, 7.0, 7.0, 7.0]\n"
        "[[base.rail]]\naxis = [1.0, 0.0, 0.0]\nrange_m = [0.2, 0.4]\nspeed_m_s = 1.0\nforce_N = 2e3\n"
    )
    (tmp_path / "six.xml").write_text(SIX_JOINTS_MJCF)
    file = find_arm(str(path))
    np.testing.assert_allclose(file.home, [0.3, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    gains = ServoGains.of(file, Arm(file).effort_limit)
    np.testing.assert_allclose(gains.stiffness, [1e5, *[7.0] * 6])
    np.testing.assert_allclose(gains.damping, [2e4, *[1.4] * 6])


def test_two_joints_of_one_name_are_refused() -> None:
    with pytest.raises(InputError, match="two joints are called 'elbow_joint'; give the one of its base"):
        placed_arm(
            "ur5e", BaseTable(rails=(RailTable((1.0, 0.0, 0.0), (0.0, 1.0), 1.0, name="elbow_joint"),))
        )


def along_a_line(arm: Arm, length_m: float) -> tuple[list[Pose], Array]:
    """Return poses of a hanging flange on a line along a rail, and joints at their begin, rail at 0.2 m."""
    poses = [Pose(DOWN, np.array([0.45, 0.2 + y, 0.6])) for y in np.linspace(0.0, length_m, 120)]
    prescribed = np.array([0.2, *[np.nan] * 6])
    return poses, solve(arm, poses[0], arm.home, prescribed=prescribed).q


def test_a_spare_joint_slows_down_before_its_limit_and_the_others_take_over() -> None:
    arm = Arm(placed_arm("ur5e", BaseTable(rails=(RailTable((0.0, 1.0, 0.0), (0.0, 1.0), 1.0),))))
    poses, start = along_a_line(arm, 1.3)
    assert start[0] == 0.2
    q = follow(arm, poses, start)
    steps = np.diff(q[:, 0])
    assert steps[:50].min() > 0.6 * steps[:50].max() > 0.0  # it shares the motion
    assert 0.99 < q[:, 0].max() <= 1.0
    assert np.abs(np.diff(steps)).max() < 0.2 * steps.max()  # it does not run into its limit
    away = [
        np.linalg.norm(arm.forward(row).translation - pose.translation)
        for row, pose in zip(q, poses, strict=True)
    ]
    assert max(away) < 1e-6


def test_joints_that_are_led_go_where_they_are_asked_and_the_flange_keeps_its_way() -> None:
    arm = Arm(placed_arm("ur5e", BaseTable(rails=(RailTable((0.0, 1.0, 0.0), (0.0, 1.0), 1.0),))))
    poses, start = along_a_line(arm, 0.3)
    prescribed = np.full((120, 7), np.nan)
    prescribed[:, 0] = np.linspace(0.2, 0.6, 120)
    q = follow(arm, poses, start, prescribed)
    np.testing.assert_array_equal(q[:, 0], prescribed[:, 0])
    assert np.linalg.norm(arm.forward(q[-1]).translation - poses[-1].translation) < 1e-6


def still(**keys: Any) -> dict[str, Any]:
    return {"name": "move", "duration_s": 1.0, **keys}


def test_phases_lead_the_base_under_a_flange_that_stands(load: Any) -> None:
    phases = (
        still(joint_shift_m={"rail": 0.4}),
        still(name="on", ramp="linear", flange_shift_m=[0.0, 0.2, 0.0]),
    )
    scenario = load(*phases, **{"arm_base": RAIL, "start.joint_shift_m": {"rail": 0.1}})
    built = build(scenario)
    arm, plan = Arm(placed_arm("ur5e", scenario.arm_base)), built._parts.plan
    first, second = (phase.joints for phase in plan.phases)
    assert plan.joints[0] == 0.1
    assert first.last[0] == pytest.approx(0.4, abs=1e-12)
    assert first.spline is not None
    assert second.spline is not None
    for fraction in np.linspace(0.0, 1.0, 23):
        flange = arm.forward(first.spline(fraction)).translation
        np.testing.assert_allclose(flange, [0.4, 0.0, 0.5], atol=2e-5)  # between knots
    assert second.last[0] > 0.45  # free again, it shares the motion
    rate = arm.jacobian(first.last) @ second.spline(0.0, 1)
    np.testing.assert_allclose(rate, [0.0, 0.2, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "key", "says"),
    [
        (
            {"joint_shift_m": {"rai": 0.4}},
            "joint_shift_m.rai",
            "no sliding joint of the arm 'rai'; did you mean 'rail'",
        ),
        ({"joint_angle_rad": {"rail": 0.4}}, "joint_angle_rad.rail", "no turning joint of the arm 'rail'"),
        ({"joint_shift_m": {"rail": 2.4}}, "joint_shift_m.rail", "is 2.4; its limits are -0.1 to 2"),
        ({"joint_shift_m": {"rail": 0.4}, "joint_angle_rad": {"elbow_joint": 1.0}}, "", "leaves 5 joints"),
    ],
)
def test_joints_that_cannot_be_led_are_refused(load: Any, keys: Any, key: str, says: str) -> None:
    with pytest.raises(ScenarioError, match=says) as caught:
        build(load(still(**keys), arm_base=RAIL))
    assert caught.value.path == ".".join(filter(None, ("phase.move", key)))


def test_without_an_arm_no_joint_is_led() -> None:
    with pytest.raises(ScenarioError, match="needs an arm"):
        cosim.load_scenario("pumped_arm", {"start.joint_shift_m": {"rail": 1.0}})


LEANING = np.array([0.3, 0.0, -0.95])
CENTER = np.array([-0.6, 0.0, 0.0])
TURNTABLE = {"turntable": [{"range_rad": [-3.0, 3.0], "speed_rad_s": 1.0, "center_m": CENTER.tolist()}]}


@pytest.mark.parametrize("base", [RAIL, TURNTABLE], ids=["rail", "turntable"])
def test_the_tip_follows_a_path_that_the_arm_alone_cannot(load: Any, base: dict[str, Any]) -> None:
    begin = np.array([0.42, 0.0, 0.42])
    turns = [rotation_from_vector(np.array([0.0, 0.0, a])) for a in np.linspace(0.0, 1.2 / 1.02, 9)]
    points, directions = [begin, begin + np.array([0.0, 1.2, 0.0])], [LEANING]
    if base is TURNTABLE:
        points, directions = (
            [CENTER + turn @ (begin - CENTER) for turn in turns],
            [turn @ LEANING for turn in turns],
        )
    target = {"position_m": points[0].tolist(), "direction": LEANING.tolist()}
    path = {
        "points_m": np.array(points).tolist(),
        "directions": np.array(directions).tolist(),
        "speed_m_s": 0.05,
    }
    phases = still(tip_target=target, settle_s=0.5), {"name": "follow", "tip_path": path}
    more = {"arm_base": base, "solver.damping_per_s": 5.0, "clock.tick_s": 0.01, "plan.collision": "off"}
    result = cosim.run(load(*phases, **more))
    along = result.summary["phases"][1]["tip_path"]
    assert along["length_m"] == pytest.approx(1.2, rel=1e-3)
    assert along["largest_error_m"] < 1e-3
    assert np.ptp(result.joint_position[:, 0]) > 0.9
    # what the flange gives is what it gets
    assert result.summary["max_momentum_error"] < 1e-12


PILLAR = {"name": "pillar", "shape": "box", "size_m": [0.1, 0.1, 1.0], "position_m": [0.0, 0.25, 0.5]}


def test_an_arm_with_spare_joints_begins_where_its_way_is_clear(load: Any) -> None:
    phases = still(flange_shift_m=[0.0, 0.1, 0.0])
    more = {"arm_base": RAIL | {"position_m": [0.0, 0.0, 0.1]}, "object": [PILLAR], "plan.clearance_m": 0.01}
    warned = build(load(phases, **more)).stage.arm
    assert warned is not None
    assert any("touches pillar" in line or "near pillar" in line for line in warned.warnings())
    clear = build(load(phases, **more, **{"plan.collision": "refuse"})).stage.arm
    assert clear is not None
    assert clear.warnings() == []
