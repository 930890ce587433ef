"""Finds the joint path of an arm for a tip path, and compares its speeds and accelerations with the
limits.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import follow, solve
from cosim.plan import arm_limits
from cosim.plan.joint_path import JointPath
from cosim.plan.ramp import progress
from cosim.plan.tip_paths import PoseTrack

_SAMPLE_s: Final = 0.005
_MOST_SAMPLES: Final = 20_000


def track_joints(
    arm: Arm, track: PoseTrack, q: Array, key: str, prescribed: Array | None = None
) -> JointPath:
    """Return the joint angles along a track, from rest to rest.

    Args:
        arm: the arm.
        track: motion of the flange.
        q: (joints,) [rad], at its start.
        key: of the scenario, for messages.
        prescribed: (joints,) [rad], angles at its end that are prescribed; NaN of the other joints.

    Raises:
        UnreachableError: the arm cannot follow it, or not at this speed; the message begins with the key.
    """
    count, knots = track.pieces, [q]
    for k in range(1, count + 1):
        pose, fractions = track.at(k / count), [progress("smooth", k / count, 1.0).value]
        try:
            knots.append(follow(arm, [pose], knots[-1], prescribed_along(q, prescribed, fractions))[0])
        except UnreachableError as error:
            place = track.instant(k / count)
            try:
                solve(arm, pose, knots[-1], candidates=1)
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
    spline = CubicSpline(np.linspace(0.0, 1.0, count + 1), np.array(knots), (0.0, 0.0))
    _check_pace(arm_limits.ArmLimits.of(arm), track, spline, key)
    return JointPath(q, spline)


def _check_pace(limits: arm_limits.ArmLimits, track: PoseTrack, spline: CubicSpline, key: str) -> None:
    """Check the speeds and accelerations of a joint path.

    Raises:
        UnreachableError: one exceeds its limit.
    """
    course = track.course
    count = min(math.ceil(course.duration_s / _SAMPLE_s), _MOST_SAMPLES)
    time_s, phase = np.linspace(0.0, course.duration_s, count + 1), np.zeros(count + 1, np.int64)
    beyond, allowed = [], course.speed_m_s
    for order, quantity in ((1, "velocity"), (2, "acceleration")):
        values = spline(time_s / course.duration_s, order) / course.duration_s**order
        found = limits.extreme(quantity, values, time_s, phase)
        if found is None or not found.beyond:
            continue
        fraction = abs(found.bound / found.value)
        ramps = min(found.time_s, course.duration_s - found.time_s) < course.ramp_s
        # the ramps accelerate by v / ramp, bends by v^2
        allowed = min(allowed, course.speed_m_s * (fraction if order == 1 or ramps else math.sqrt(fraction)))
        longer = f" (or give a ramp_s above {course.ramp_s / fraction:.3g})" if order == 2 and ramps else ""
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


def prescribed_along(q: Array, prescribed: Array | None, fractions: Sequence[float]) -> Array | None:
    """Return prescribed angles at fractions of a motion that starts from q; None without any.

    Args:
        q: (joints,) [rad], at the start.
        prescribed: (joints,) [rad], at the end; NaN of free joints.
        fractions: n fractions, 0 to 1.

    Returns:
        (n, joints) [rad].
    """
    if prescribed is None or np.isnan(prescribed).all():
        return None
    return np.asarray(q + np.array(fractions)[:, None] * (prescribed - q))
