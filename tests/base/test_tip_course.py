"""Courses of a tip: smooth curves through points at one speed."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.tip_course import TipCourse, course_of
from cosim.errors import InputError

DOWN = [[0.0, 0.0, -1.0]]
ANGLES = np.linspace(0.0, np.pi, 13)
ARC = np.stack([0.1 * np.cos(ANGLES), 0.1 * np.sin(ANGLES), 0.0 * ANGLES + 0.5], axis=1)


def arc() -> TipCourse:
    tilt = np.radians(np.linspace(-15.0, 15.0, len(ARC)))
    directions = np.stack([np.sin(tilt), 0.0 * tilt, -np.cos(tilt)], axis=1)
    return TipCourse(ARC, directions, 0.05, 0.4)


def test_a_line_takes_its_length_over_the_speed_and_one_ramp() -> None:
    course = course_of([[0.0, 0.0, 0.5], [0.15, 0.0, 0.5]], DOWN, 0.02, 0.5)
    assert course.length_m == pytest.approx(0.15)
    assert course.duration_s == pytest.approx(0.15 / 0.02 + 0.5)
    middle = course.at(0.5 * course.duration_s)
    np.testing.assert_allclose(middle.position, [0.075, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(middle.velocity, [0.02, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(middle.direction, DOWN[0])


def test_an_arc_is_as_long_as_its_circle_says() -> None:
    # a spline through 13 points leaves the circle by some (pi / 12)^4 / 384 of its radius, more at its ends
    course = arc()
    assert course.length_m == pytest.approx(0.1 * np.pi, rel=1e-4)
    found = course.at(np.linspace(0.0, course.duration_s, 301))
    np.testing.assert_allclose(np.linalg.norm(found.position[:, :2], axis=1), 0.1, rtol=2e-4)
    assert np.linalg.norm(found.velocity[100:200], axis=1) == pytest.approx(0.05, rel=1e-4)


def test_velocity_and_acceleration_are_the_derivatives_of_the_place() -> None:
    course, h = arc(), 1e-4
    time_s = np.linspace(0.01, course.duration_s - 0.01, 97)
    before, here, after = (course.at(time_s + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((after.position - before.position) / (2.0 * h), here.velocity, atol=1e-6)
    second = (after.position - 2.0 * here.position + before.position) / h**2
    np.testing.assert_allclose(second, here.acceleration, atol=1e-3)


def test_it_begins_and_ends_at_rest_on_its_first_and_last_point() -> None:
    course = arc()
    ends = course.at(np.array([-1.0, 0.0, course.duration_s, course.duration_s + 1.0]))
    np.testing.assert_allclose(ends.position, ARC[[0, 0, -1, -1]], atol=1e-9)
    np.testing.assert_allclose(ends.velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends.acceleration, 0.0, atol=1e-9)
    assert ends.direction is not None
    turned = np.degrees(np.arccos(ends.direction[0] @ ends.direction[-1]))
    assert turned == pytest.approx(30.0)


def test_knots_go_from_begin_to_end_in_small_steps() -> None:
    course = arc()
    knots = course.knots(8e-3, 0.06, 10)
    assert knots[0] == 0.0
    assert knots[-1] == pytest.approx(course.duration_s)
    assert (np.diff(knots) > 0.0).all()
    assert np.diff(course.at(knots).along_m).max() <= 8e-3


@pytest.mark.parametrize(
    ("points", "directions", "says"),
    [
        ([[0.0, 0.0, 0.5]], DOWN, "two points at least"),
        ([[0.0, 0.0, 0.5], [0.1, 0.0, 0.5], [0.1, 0.0, 0.5]], DOWN, "point 3 is the same"),
        ([[0.0, 0.0, 0.5], [0.001, 0.0, 0.5]], DOWN, "too short to reach 0.02 m/s"),
        ([[0.0, 0.0, 0.5], [0.1, 0.0, 0.5], [0.2, 0.0, 0.5]], 2 * DOWN, "2 directions"),
        ([[0.0, 0.0, 0.5], [0.1, 0.0, 0.5]], [[0.0, 0.0, -1.0], [0.1, 0.0, 1.0]], "from point 1 to point 2"),
    ],
)
def test_what_makes_no_course_is_refused(
    points: list[list[float]], directions: list[list[float]], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        course_of(points, directions, 0.02, 0.5)
