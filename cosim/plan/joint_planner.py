"""Finds the joint paths of an arm for the flange's motion through all phases, on one branch of the inverse
kinematics.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

import numpy as np

from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array, Mask, Pose, rotation_from_vector
from cosim.config.schema.phase import JOINT_KEYS, PhaseTable, StartTable
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Faults
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import follow, solve
from cosim.plan.flange_motion import FlangeMotion
from cosim.plan.joint_path import JointPath
from cosim.plan.tip_paths import AnyFlangeMotion, PoseTrack
from cosim.plan.track_joints import prescribed_along, track_joints

_NEEDED: Final = 6  # joints that must follow the flange if others are prescribed
_START_CONFIGURATIONS = 12
_PRESCRIBED_STEP = 0.05  # m or rad, of a joint that is prescribed
_FINER = 2  # factor on the steps of a motion with constant speed
_SINGULAR = 1e-3  # over the Jacobian's largest singular value: directions below are left out
_ROLLS = (1.57, -1.57, 3.14, -3.14, 0.79, -0.79, 2.36, -2.36)  # tried rolls, with the digits of the message


def prescribed_joints(arm: Arm, start: StartTable, phases: Sequence[PhaseTable]) -> tuple[Array, ...]:
    """Return the prescribed joint angles (joints,) [rad] at the start and each phase's end; NaN: free.

    Args:
        arm: with the joints.
        start: of a scenario.
        phases: of the scenario.

    Raises:
        ScenarioError: a joint is unknown, of another kind or beyond its limits, or too few are free.
    """
    faults, rows = Faults(), []
    places = ["start", *(f"phase.{phase.name}" for phase in phases)]
    for where, table in zip(places, (start, *phases), strict=True):
        row = np.full(arm.joint_count, np.nan)
        for key, kind, slides in zip(JOINT_KEYS, ("sliding", "turning"), (True, False), strict=True):
            fitting = [
                name for name, own in zip(arm.joint_names, arm.prismatic, strict=True) if own == slides
            ]
            for name, value in (getattr(table, key) or {}).items():
                path = f"{where}.{key}.{name}"
                if name not in fitting:
                    faults.add(path, unknown_name_message(f"{kind} joint of the arm", name, tuple(fitting)))
                    continue
                k = arm.joint_names.index(name)
                row[k] = value
                if not arm.lower[k] <= value <= arm.upper[k]:
                    faults.add(path, f"is {value:g}; its limits are {arm.lower[k]:g} to {arm.upper[k]:g}")
        free, needed = int(np.isnan(row).sum()), min(_NEEDED, arm.joint_count)
        if free < needed:
            faults.add(where, f"leaves {free} joints to follow the flange; at least {needed} are needed")
        rows.append(row)
    faults.raise_all()
    return tuple(rows)


def plan_joints(
    arm: Arm,
    start: Pose,
    ways: list[AnyFlangeMotion],
    blame: Callable[[int], str],
    prescribed: Sequence[Array] = (),
    clear: Callable[[tuple[JointPath, ...]], bool] | None = None,
) -> tuple[JointPath, ...]:
    """Return the joint paths of all phases, on one branch of the inverse kinematics.

    Several start configurations are tried, the one nearest to the arm's home first, until one can follow
    every phase and keeps its clearances. If none keeps its clearances, the first that can follow is returned.
    If none can follow, the error names an end pose that is out of reach, if there is one.

    Args:
        arm: the arm.
        start: pose of the flange before the first phase.
        ways: motion of the flange in each phase.
        blame: returns the key of the scenario that gives pose k (-1: the start).
        prescribed: (joints,) [rad] at the start and at the end of each phase; NaN of joints that follow the
            flange. Empty: all do.
        clear: returns whether joint paths keep their clearances; None: they are not checked.

    Raises:
        UnreachableError: the start or a path cannot be reached; the message begins with the key.
    """
    prescribed = prescribed or [np.full(arm.joint_count, np.nan)] * (1 + len(ways))
    try:
        nearest = nearest_start(arm, start, prescribed[0])
    except UnreachableError as error:
        raise UnreachableError(
            f"{blame(-1)}: {error}{_rolled_otherwise(arm, start)}", error.closest
        ) from error
    _check_reach(arm, ways, nearest, blame)
    failure: UnreachableError | None = None
    touching: tuple[JointPath, ...] | None = None
    for candidate in _configurations(arm, start, nearest, prescribed[0]):
        try:
            paths = _follow_all(arm, ways, candidate, blame, prescribed[1:])
        except UnreachableError as error:
            failure = failure or error
            continue
        if clear is None or clear(paths):
            return paths
        touching = touching or paths
    if touching is not None:
        return touching
    assert failure is not None
    _check_ends(arm, ways, nearest, blame)
    raise failure


def nearest_start(arm: Arm, start: Pose, prescribed: Array) -> Array:
    """Return the start configuration (joints,) [rad] nearest to an arm's home; see `plan_joints`."""
    return solve(arm, start, arm.home, prescribed=prescribed).q


def _rolled_otherwise(arm: Arm, start: Pose) -> str:
    """Return text on a roll at which the start pose can be reached; empty if none is found."""
    if arm.free_roll or np.linalg.norm(start.translation - arm.shoulder) > arm.reach:
        return ""
    for turn in _ROLLS:
        roll = Pose(rotation_from_vector(np.array([0.0, 0.0, turn])), np.zeros(3))
        with suppress(UnreachableError):
            solve(arm, start @ roll, arm.home, candidates=1, restarts=20)
            change = f"add {turn:.2f} to" if turn > 0.0 else f"subtract {-turn:.2f} from"
            return f"; it can be there if you {change} its roll_rad"
    return ""


def _check_reach(arm: Arm, ways: list[AnyFlangeMotion], seed: Array, blame: Callable[[int], str]) -> None:
    """Check that no phase ends farther away than the arm's reach, before long motions are followed.

    Raises:
        UnreachableError: one does; the message begins with its key.
    """
    for index, way in enumerate(ways):
        far = np.linalg.norm(way.end.translation - arm.shoulder) > arm.reach
        if far and not isinstance(way, PoseTrack):
            with _with_key(blame(index)):
                solve(arm, way.end, seed, candidates=1)


def _check_ends(arm: Arm, ways: list[AnyFlangeMotion], seed: Array, blame: Callable[[int], str]) -> None:
    """Check that the end of each phase can be reached, on any branch.

    Raises:
        UnreachableError: one cannot; the message begins with its key.
    """
    for index, way in enumerate(ways):
        if way.pieces and not isinstance(way, PoseTrack):  # errors of a track name the place along it
            with _with_key(blame(index)):
                solve(arm, way.end, seed, candidates=1)


@contextmanager
def _with_key(key: str) -> Iterator[None]:
    """Put a key in front of the message of an UnreachableError that is raised within."""
    try:
        yield
    except UnreachableError as error:
        raise UnreachableError(f"{key}: {error}", error.closest) from error


def _configurations(arm: Arm, start: Pose, nearest: Array, prescribed: Array) -> Iterator[Array]:
    """Yield start configurations; those after the nearest are computed only if they are needed."""
    yield nearest
    rng = np.random.default_rng(0)
    found = [nearest]
    for _ in range(_START_CONFIGURATIONS):
        seed = rng.uniform(np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi))
        try:
            q = solve(arm, start, seed, prescribed=prescribed).q
        except UnreachableError:
            continue
        if all(np.abs(q - other).max() > 1e-3 for other in found):
            found.append(q)
    yield from sorted(found[1:], key=lambda q: float(np.linalg.norm(q - arm.home)))


def _follow_all(
    arm: Arm, ways: list[AnyFlangeMotion], q: Array, blame: Callable[[int], str], prescribed: Sequence[Array]
) -> tuple[JointPath, ...]:
    paths: list[JointPath] = []
    for index, (way, asked) in enumerate(zip(ways, prescribed, strict=False)):
        if isinstance(way, PoseTrack):
            paths.append(track_joints(arm, way, q, blame(index), asked))
            q = paths[-1].last
            continue
        count = max(way.pieces * (_FINER if way.even else 1), _prescribed_steps(q, asked))
        if count == 0:
            paths.append(JointPath(q, None))
            continue
        fractions = [k / count for k in range(1, count + 1)]
        poses = [way.at(fraction) for fraction in fractions]
        with _with_key(blame(index)):
            knots = np.concatenate([q[None], follow(arm, poses, q, prescribed_along(q, asked, fractions))])
        paths.append(JointPath(q, _spline(arm, way, knots, np.isnan(asked))))
        q = paths[-1].last
    return tuple(paths)


def _prescribed_steps(q: Array, prescribed: Array) -> int:
    """Return the number of steps of a motion for its prescribed joints; 0 if none moves."""
    farthest = float(np.nan_to_num(np.abs(prescribed - q)).max())
    return 0 if farthest == 0.0 else max(4, math.ceil(farthest / _PRESCRIBED_STEP))


def _spline(arm: Arm, way: FlangeMotion, knots: Array, free: Mask) -> CubicSpline:
    """Return the joint angles over the fraction of a motion, through equally spaced knots (k, joints) [rad].

    At ends that are not at rest, the flange's velocity is exactly that of the motion, so successive motions
    at the same speed have no jump. Only free joints are corrected for it.
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
        slope[free] += np.linalg.lstsq(rows @ jacobian[:, free], rows @ missing, rcond=_SINGULAR)[0]
        slopes.append(slope)
    return CubicSpline(fractions, knots, (slopes[0], slopes[1]))
