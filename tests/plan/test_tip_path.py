"""The tip follows a path: planned on the statics, run coupled, refused where it cannot be."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Pose, rotation_from_vector
from cosim.base.tip_course import TipCourse, course_of
from cosim.build.arms import find_arm
from cosim.errors import ScenarioError, UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import solve
from cosim.plan.flange_motion import rotation_from_direction
from cosim.plan.tip_paths import PoseTrack
from cosim.plan.track_joints import track_joints

BEGIN = [0.42, 0.0, 0.42]
LEANING = [0.3, 0.0, -0.95]
POINTS = [BEGIN, [0.44, 0.05, 0.43], [0.42, 0.1, 0.42]]
REACH = {
    "name": "reach", "duration_s": 1.0, "settle_s": 1.0,
    "tip_target": {"position_m": BEGIN, "direction": LEANING},
}  # fmt: skip


def follow(**changes: Any) -> dict[str, Any]:
    path = {"points_m": POINTS, "directions": [LEANING, [0.15, 0.1, -0.95], [0.0, 0.2, -0.95]]}
    return {"name": "follow", "increments": 12, "tip_path": {**path, "speed_m_s": 0.05, **changes}}


@pytest.mark.parametrize("damping_per_s", [5.0, 40.0])
def test_the_tip_stays_on_its_path_through_a_coupled_run(load: Any, damping_per_s: float) -> None:
    result = cosim.run(load(REACH, follow(), **{"solver.damping_per_s": damping_per_s}))
    path = result.summary["phases"][-1]["tip_path"]
    # a swing of a tenth of the sag that is compensated
    assert path["largest_error_m"] < 5e-4
    assert path["largest_angle_rad"] < np.radians(0.5)
    assert path["planned"]["largest_error_m"] < 2e-5
    assert path["uncompensated"]["largest_error_m"] > 5.0 * path["largest_error_m"]
    rows = result.phase == 1
    course = result.stage.tip_paths[1].planned.course
    assert course.length_m == pytest.approx(path["length_m"])
    passed = result.tip_position[rows][: round(course.duration_s / result.stage.tick_s)]
    steps = np.linalg.norm(np.diff(passed, axis=0), axis=1) / result.stage.tick_s
    middle = steps[len(steps) // 3 : 2 * len(steps) // 3]
    assert middle == pytest.approx(0.05, rel=0.05)
    # the reference neither jumps nor goes beyond what the arm can
    planned = result.summary["arm"]["planned"]
    assert not planned["velocity"]["beyond"]
    assert not planned["acceleration"]["beyond"]


def test_in_statics_every_increment_is_on_the_path(load: Any) -> None:
    scenario = load({**REACH, "increments": 10}, follow(), mode="quasistatic")
    result = cosim.run(scenario)
    path = result.summary["phases"][-1]["tip_path"]
    # between instants of the plan; the arm's servos give way by some 0.1 mm
    assert path["largest_error_m"] < 3e-4
    assert path["uncompensated"]["largest_error_m"] > 1e-3


def test_without_compensation_the_run_shows_what_was_foretold(load: Any) -> None:
    straight = {**REACH, "tip_target": {**REACH["tip_target"], "reach_with": "none"}}
    result = cosim.run(load(straight, follow(reach_with="none"), **{"solver.damping_per_s": 5.0}))
    path = result.summary["phases"][-1]["tip_path"]
    assert path["largest_error_m"] == pytest.approx(path["uncompensated"]["largest_error_m"], rel=0.2)


def test_a_direction_that_is_left_out_is_free(load: Any) -> None:
    result = cosim.run(load(REACH, follow(directions=[]), mode="quasistatic"))
    path = result.summary["phases"][-1]["tip_path"]
    assert path["largest_error_m"] < 3e-4
    assert path["largest_angle_rad"] == 0.0


@pytest.mark.parametrize(
    ("phases", "key", "says"),
    [
        ([follow()], "phase.follow.tip_path", r"begins .* mm and .* tip_target = { position_m = \[0\.42"),
        (
            [REACH, follow(points_m=[BEGIN, [1.3, 0.0, 0.42]], directions=[LEANING])],
            "phase.follow.tip_path", r"mm along .* cannot bring its flange to .* nearer",
        ),
        (
            [REACH, follow(speed_m_s=0.5, ramp_s=0.1)],
            "phase.follow.tip_path.speed_m_s",
            r"0.5 is too fast: [\d.]+ mm along .* its bound is .* give at most",
        ),
        (
            [REACH, follow(speed_m_s=3.0, ramp_s=0.03)],
            "phase.follow.tip_path",
            r"[\d.]+ mm along .* accelerates by .* a lower speed_m_s",
        ),
        (
            [REACH, follow(reach_with="none")],
            "phase.follow.tip_path",
            r"straight arm begins on the path, .* tip_target = { [^}]*, reach_with = 'none' }",
        ),
    ],
)  # fmt: skip
def test_a_path_that_cannot_be_followed_is_refused_with_its_place(
    load: Any, phases: list[dict[str, Any]], key: str, says: str
) -> None:
    with pytest.raises(ScenarioError, match=says) as caught:
        cosim.run(load(*phases))
    assert caught.value.path == key


def flange_track(points: list[list[float]], speed_m_s: float, ramp_s: float) -> PoseTrack:
    """Return the track of a flange that hangs, and is itself the tip."""
    course: TipCourse = course_of(points, [[0.0, 0.0, -1.0]], speed_m_s, ramp_s)
    time_s = course.knots(8e-3, 0.06, 10)
    rotation = rotation_from_direction(np.array([0.0, 0.0, -1.0]))
    return PoseTrack(time_s, [Pose(rotation, x) for x in course.at(time_s).position], course)


def test_joints_along_a_track_have_its_places_and_rest_at_its_ends() -> None:
    arm = Arm(find_arm("ur5e"))
    track = flange_track([[0.4, -0.1, 0.4], [0.45, 0.0, 0.45], [0.4, 0.1, 0.4]], 0.1, 0.3)
    path = track_joints(arm, track, solve(arm, track.begin, arm.home).q, "key")
    assert path.spline is not None
    for fraction in np.linspace(0.0, 1.0, 37):
        wanted = track.instant(fraction).position
        # between knots of both splines
        assert np.linalg.norm(arm.forward(path.spline(fraction)).translation - wanted) < 5e-6
    np.testing.assert_allclose(path.spline([0.0, 1.0], 1), 0.0, atol=1e-9)


def test_a_track_turns_on_where_quaternions_change_their_sign() -> None:
    course = course_of([[0.4, 0.0, 0.4], [0.4, 0.1, 0.4]], [], 0.1, 0.2)
    angles = np.radians([150.0, 165.0, 180.0, 195.0, 210.0])
    poses = [Pose(rotation_from_vector(np.array([0.0, 0.0, angle])), np.zeros(3)) for angle in angles]
    assert min(a.quaternion @ b.quaternion for a, b in pairwise(poses)) < 0.0
    track = PoseTrack(np.linspace(0.0, 1.0, 5), poses, course)
    turned = np.array([track.at(fraction).rotation for fraction in np.linspace(0.0, 1.0, 41)])
    steps = [np.linalg.norm(np.cross(a[:, 0], b[:, 0])) for a, b in pairwise(turned)]
    assert max(steps) < np.radians(3.0)  # 60 degrees in 40 steps, from rest to rest


@pytest.mark.parametrize(
    ("speed_m_s", "ramp_s", "quantity"), [(1.6, 0.3, "velocity"), (0.8, 0.03, "acceleration")]
)
def test_a_track_too_fast_for_the_joints_is_refused_and_slower_is_not(
    speed_m_s: float, ramp_s: float, quantity: str
) -> None:
    arm = Arm(find_arm("ur5e"))
    points = [[0.3, -0.3, 0.4], [0.3, 0.3, 0.4]]
    track = flange_track(points, speed_m_s, ramp_s)
    q = solve(arm, track.begin, arm.home).q
    with pytest.raises(UnreachableError, match=rf"^key\.speed_m_s: .* of {quantity}, its") as caught:
        track_joints(arm, track, q, "key")
    allowed = float(str(caught.value).partition("give at most ")[2].split(",")[0])
    assert 0.05 * speed_m_s < allowed < speed_m_s
    track_joints(arm, flange_track(points, allowed, ramp_s), q, "key")
