"""Joint angles along a flange's track, held against the arm's speeds and accelerations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.frames import Array
from cosim.errors import UnreachableError
from cosim.kinematics.inverse_kinematics import InverseKinematicsOptions, follow, solve
from cosim.plan.arm_limits import ArmLimits
from cosim.plan.joint_path import JointPath
from cosim.plan.paths.pose_track import PoseTrack

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm

_SAMPLE_s: Final = 0.005
_MOST_SAMPLES: Final = 20_000
_ONE: Final = InverseKinematicsOptions(candidates=1)


def track_joints(arm: Arm, track: PoseTrack, q: Array, key: str) -> JointPath:
    """Return the joint angles along a track, from rest to rest.

    Args:
        arm: the arm.
        track: of the flange.
        q: (joints,) [rad], at its begin.
        key: of the scenario that asks for it.

    Raises:
        UnreachableError: the arm cannot follow it, or not as fast; the message begins with the key.
    """
    count, knots = track.pieces, [q]
    for k in range(1, count + 1):
        pose = track.at(k / count)
        try:
            knots.append(follow(arm, [pose], knots[-1])[0])
        except UnreachableError as error:
            place = track.instant(k / count)
            try:
                solve(arm, pose, knots[-1], _ONE)
            except UnreachableError as far:
                remedy = "bring the path nearer to the arm, or turn its directions"
                raise UnreachableError(f"{key}: {place}: {far}; {remedy}", far.closest) from far
            joints = ", ".join(f"{angle:.3f}" for angle in knots[-1])
            raise UnreachableError(
                f"{key}: {place}: arm {arm.name!r} gets no farther from its joints at [{joints}] rad, near a "
                "singular configuration or a joint's limit, though it reaches that pose otherwise; turn or "
                "move the path, or let the flange start elsewhere or with another roll_rad",
                error.closest,
            ) from error
    spline = CubicSpline(np.linspace(0.0, 1.0, count + 1), np.array(knots), bc_type="clamped")
    _check_pace(ArmLimits.of(arm), track, spline, key)
    return JointPath(q, spline)


def _check_pace(limits: ArmLimits, track: PoseTrack, spline: CubicSpline, key: str) -> None:
    """Raise UnreachableError where a joint would have to be faster, or to accelerate more, than it can."""
    course = track.course
    count = min(math.ceil(course.duration_s / _SAMPLE_s), _MOST_SAMPLES)
    time_s, phase = np.linspace(0.0, course.duration_s, count + 1), np.zeros(count + 1, np.int64)
    beyond, allowed = [], course.speed_m_s
    for order, quantity in ((1, "velocity"), (2, "acceleration")):
        values = spline(time_s / course.duration_s, order) / course.duration_s**order
        found = limits.extreme(quantity, values, time_s, phase)
        if found is None or not found.beyond:
            continue
        share = abs(found.bound / found.value)
        ramps = min(found.time_s, course.duration_s - found.time_s) < course.ramp_s
        # the ramps accelerate by v / ramp, bends by v^2
        allowed = min(allowed, course.speed_m_s * (share if order == 1 or ramps else math.sqrt(share)))
        longer = f" (or give a ramp_s above {course.ramp_s / share:.3g})" if order == 2 and ramps else ""
        beyond.append(
            f"{course.at(found.time_s)}, joint {found.joint} would need {abs(found.value):.3g} {found.unit} "
            f"of {quantity}, its bound is {found.bound:.3g}{longer}"
        )
    if beyond:
        raise UnreachableError(
            f"{key}.speed_m_s: {course.speed_m_s:g} is too fast: {'; '.join(beyond)}; give at most "
            f"{_below(allowed)}, or a path farther from where the arm is stretched out or its wrist folded"
        )


def _below(value: float) -> str:
    """Return a number with two digits, rounded down."""
    digits = 1 - math.floor(math.log10(value))
    return f"{math.floor(value * 10.0**digits) / 10.0**digits:.6g}"
