"""Joint angles of an arm along the flange's way through all phases."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import InverseKinematicsOptions, follow, solve
from cosim.plan.flange_path import FlangeWay
from cosim.plan.joint_path import JointPath
from cosim.plan.paths.phase_motion import AnyWay
from cosim.plan.paths.pose_track import PoseTrack
from cosim.plan.paths.track_joints import track_joints

_START_CONFIGURATIONS = 12
_FINER = 2  # pieces of a way whose velocity is to be even
_SINGULAR = 1e-3  # of the Jacobian's largest singular value: no velocity is asked for that way
_END_OPTIONS = InverseKinematicsOptions(candidates=1)
_ROLL_OPTIONS = InverseKinematicsOptions(candidates=1, restarts=20)
_ROLLS = tuple(sign * quarter * math.pi / 4.0 for quarter in (2, 4, 1, 3) for sign in (1.0, -1.0))  # tried


def plan_joints(
    arm: Arm, start: Pose, ways: list[AnyWay], blame: Callable[[int], str]
) -> tuple[JointPath, ...]:
    """Return the joint paths of all phases, on one branch of the inverse kinematics.

    Several start configurations are tried, the one nearest to the arm's home first, until one can follow
    every phase. Where none can, an end pose that is out of reach says more than the place where a path broke
    off, so it is named instead.

    Args:
        arm: the arm.
        start: pose of the flange before the first phase.
        ways: motion of the flange in each phase.
        blame: names the key of the scenario that asks for pose k (-1: the start).

    Raises:
        UnreachableError: the start or a path cannot be reached; the message begins with the key.
    """
    try:
        nearest = solve(arm, start, arm.home).q
    except UnreachableError as error:
        raise UnreachableError(
            f"{blame(-1)}: {error}{_rolled_otherwise(arm, start)}", error.closest
        ) from error
    _check_reach(arm, ways, nearest, blame)
    failure: UnreachableError | None = None
    for candidate in _configurations(arm, start, nearest):
        try:
            return _follow_all(arm, ways, candidate, blame)
        except UnreachableError as error:
            failure = failure or error
    assert failure is not None
    _check_ends(arm, ways, nearest, blame)
    raise failure


def _rolled_otherwise(arm: Arm, start: Pose) -> str:
    """Return which roll of the flange would do where the one asked for does not; empty if none is found."""
    if arm.free_roll or np.linalg.norm(start.translation - arm.shoulder) > arm.reach:
        return ""
    for turn in _ROLLS:
        roll = Pose(rotation_from_vector(np.array([0.0, 0.0, turn])), np.zeros(3))
        with suppress(UnreachableError):
            solve(arm, start @ roll, arm.home, _ROLL_OPTIONS)
            return f"; with its roll_rad {abs(turn):.2f} {'more' if turn > 0.0 else 'less'} it can be there"
    return ""


def _check_reach(arm: Arm, ways: list[AnyWay], seed: Array, blame: Callable[[int], str]) -> None:
    """Raise UnreachableError for the first phase that ends farther away than the arm is long.

    So that no way is followed that is cut into more pieces than the arm's reach has.
    """
    for index, way in enumerate(ways):
        far = np.linalg.norm(way.end.translation - arm.shoulder) > arm.reach
        if far and not isinstance(way, PoseTrack):
            _check_end(arm, index, way, seed, blame)


def _check_ends(arm: Arm, ways: list[AnyWay], seed: Array, blame: Callable[[int], str]) -> None:
    """Raise UnreachableError for the first phase whose end no configuration reaches, on whatever branch."""
    for index, way in enumerate(ways):
        if way.pieces == 0 or isinstance(way, PoseTrack):  # of which it is said where it breaks off
            continue
        _check_end(arm, index, way, seed, blame)


def _check_end(arm: Arm, index: int, way: AnyWay, seed: Array, blame: Callable[[int], str]) -> None:
    try:
        solve(arm, way.end, seed, _END_OPTIONS)
    except UnreachableError as error:
        raise UnreachableError(f"{blame(index)}: {error}", error.closest) from error


def _configurations(arm: Arm, start: Pose, nearest: Array) -> Iterator[Array]:
    """Yield start configurations; those beside the nearest are found once somebody asks for them."""
    yield nearest
    rng = np.random.default_rng(0)
    found = [nearest]
    for _ in range(_START_CONFIGURATIONS):
        seed = rng.uniform(np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi))
        try:
            q = solve(arm, start, seed).q
        except UnreachableError:
            continue
        if all(np.abs(q - other).max() > 1e-3 for other in found):
            found.append(q)
    yield from sorted(found[1:], key=lambda q: float(np.linalg.norm(q - arm.home)))


def _follow_all(arm: Arm, ways: list[AnyWay], q: Array, blame: Callable[[int], str]) -> tuple[JointPath, ...]:
    paths: list[JointPath] = []
    for index, way in enumerate(ways):
        if isinstance(way, PoseTrack):
            paths.append(track_joints(arm, way, q, blame(index)))
            q = paths[-1].last
            continue
        count = way.pieces * (_FINER if way.even else 1)
        if count == 0:
            paths.append(JointPath(q, None))
            continue
        poses = [way.at(k / count) for k in range(1, count + 1)]
        try:
            knots = np.concatenate([q[None], follow(arm, poses, q)])
        except UnreachableError as error:
            raise UnreachableError(f"{blame(index)}: {error}", error.closest) from error
        paths.append(JointPath(q, _spline(arm, way, knots)))
        q = paths[-1].last
    return tuple(paths)


def _spline(arm: Arm, way: FlangeWay, knots: Array) -> CubicSpline:
    """Return the joint angles over the fraction of the way, through equally spaced knots (k, joints) [rad].

    Where the ends are not at rest, the flange's velocity there is exactly the way's: motions that follow one
    another at the same pace do so without a jump.
    """
    fractions = np.linspace(0.0, 1.0, len(knots))
    spline = CubicSpline(fractions, knots)
    if not way.even:
        return spline
    slopes = []
    for fraction in (0.0, 1.0):
        q, slope = np.asarray(spline(fraction)), np.asarray(spline(fraction, 1))
        rows, jacobian = arm.asked_rows(q), arm.jacobian(q)
        missing = way.rate_at_ends - jacobian @ slope
        slopes.append(slope + np.linalg.lstsq(rows @ jacobian, rows @ missing, rcond=_SINGULAR)[0])
    return CubicSpline(fractions, knots, bc_type=((1, slopes[0]), (1, slopes[1])))
