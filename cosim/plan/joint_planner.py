"""Joint angles of an arm along the flange's way through all phases.

Joint angles along a flange's track, held against the arm's speeds and accelerations.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.frames import Array, Mask, Pose, rotation_from_vector
from cosim.config.schema.phase import JOINT_KEYS, PhaseTable, StartTable
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Faults
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import follow, solve
from cosim.plan import arm_limits, planning
from cosim.plan.motion import FlangeWay, JointPath, progress
from cosim.plan.tip_paths import PoseTrack

_SAMPLE_s: Final = 0.005
_MOST_SAMPLES: Final = 20_000


def track_joints(arm: Arm, track: PoseTrack, q: Array, key: str, led: Array | None = None) -> JointPath:
    """Return the joint angles along a track, from rest to rest.

    Args:
        arm: the arm.
        track: of the flange.
        q: (joints,) [rad], at its begin.
        key: of the scenario that asks for it.
        led: (joints,) [rad], where some joints are to be at its end; nan of the others.

    Raises:
        UnreachableError: the arm cannot follow it, or not as fast; the message begins with the key.
    """
    count, knots = track.pieces, [q]
    for k in range(1, count + 1):
        pose, shares = track.at(k / count), [progress("smooth", k / count, 1.0).value]
        try:
            knots.append(follow(arm, [pose], knots[-1], _led_through(q, led, shares))[0])
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
    spline = CubicSpline(np.linspace(0.0, 1.0, count + 1), np.array(knots), bc_type="clamped")
    _check_pace(arm_limits.ArmLimits.of(arm), track, spline, key)
    return JointPath(q, spline)


def _check_pace(limits: arm_limits.ArmLimits, track: PoseTrack, spline: CubicSpline, key: str) -> None:
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


_NEEDED: Final = 6  # joints that follow the flange, where others are led


def led_joints(arm: Arm, start: StartTable, phases: Sequence[PhaseTable]) -> tuple[Array, ...]:
    """Return where joints are asked to be (joints,) [rad], at the start and each phase's end; nan: anywhere.

    Args:
        arm: whose joints.
        start: of a scenario.
        phases: of it.

    Raises:
        ScenarioError: no such joint, of another kind, out of its limits, or too few others.
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
        free = int(np.isnan(row).sum())
        if free < min(_NEEDED, arm.joint_count):
            faults.add(where, f"leaves {free} joints to follow the flange; at least {_NEEDED} are needed")
        rows.append(row)
    faults.raise_all()
    return tuple(rows)


_START_CONFIGURATIONS = 12
_LED_STEP = 0.05  # m or rad, of a joint that is led
_FINER = 2  # pieces of a way whose velocity is to be even
_SINGULAR = 1e-3  # of the Jacobian's largest singular value: no velocity is asked for that way
_ROLLS = (1.57, -1.57, 3.14, -3.14, 0.79, -0.79, 2.36, -2.36)  # tried, in the digits that the message has


def plan_joints(
    arm: Arm,
    start: Pose,
    ways: list[planning.AnyWay],
    blame: Callable[[int], str],
    led: Sequence[Array] = (),
    clear: Callable[[tuple[JointPath, ...]], bool] | None = None,
) -> tuple[JointPath, ...]:
    """Return the joint paths of all phases, on one branch of the inverse kinematics.

    Several start configurations are tried, the one nearest to the arm's home first, until one can follow
    every phase, and keeps clear of things meanwhile; where none keeps clear, the first that can follow is
    taken. Where none can follow, an end pose that is out of reach says more than the place where a path broke
    off, so it is named instead.

    Args:
        arm: the arm.
        start: pose of the flange before the first phase.
        ways: motion of the flange in each phase.
        blame: names the key of the scenario that asks for pose k (-1: the start).
        led: (joints,) [rad] at the start and at the end of each phase, where some joints are to be; nan of
            those that follow the flange. Empty: all do.
        clear: whether links keep clear of things on such paths; None: it does not matter.

    Raises:
        UnreachableError: the start or a path cannot be reached; the message begins with the key.
    """
    led = led or [np.full(arm.joint_count, np.nan)] * (1 + len(ways))
    try:
        nearest = nearest_start(arm, start, led[0])
    except UnreachableError as error:
        raise UnreachableError(
            f"{blame(-1)}: {error}{_rolled_otherwise(arm, start)}", error.closest
        ) from error
    _check_reach(arm, ways, nearest, blame)
    failure: UnreachableError | None = None
    touching: tuple[JointPath, ...] | None = None
    for candidate in _configurations(arm, start, nearest, led[0]):
        try:
            paths = _follow_all(arm, ways, candidate, blame, led[1:])
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


def nearest_start(arm: Arm, start: Pose, led: Array) -> Array:
    """Return the start configuration (joints,) [rad] nearest to an arm's home; see `plan_joints`."""
    return solve(arm, start, arm.home, led=led).q


def _rolled_otherwise(arm: Arm, start: Pose) -> str:
    """Return which roll of the flange would do where the one asked for does not; empty if none is found."""
    if arm.free_roll or np.linalg.norm(start.translation - arm.shoulder) > arm.reach:
        return ""
    for turn in _ROLLS:
        roll = Pose(rotation_from_vector(np.array([0.0, 0.0, turn])), np.zeros(3))
        with suppress(UnreachableError):
            solve(arm, start @ roll, arm.home, candidates=1, restarts=20)
            change = f"add {turn:.2f} to" if turn > 0.0 else f"subtract {-turn:.2f} from"
            return f"; it can be there if you {change} its roll_rad"
    return ""


def _check_reach(arm: Arm, ways: list[planning.AnyWay], seed: Array, blame: Callable[[int], str]) -> None:
    """Raise UnreachableError for the first phase that ends farther away than the arm is long.

    So that no way is followed that is cut into more pieces than the arm's reach has.
    """
    for index, way in enumerate(ways):
        far = np.linalg.norm(way.end.translation - arm.shoulder) > arm.reach
        if far and not isinstance(way, PoseTrack):
            with _blamed(blame(index)):
                solve(arm, way.end, seed, candidates=1)


def _check_ends(arm: Arm, ways: list[planning.AnyWay], seed: Array, blame: Callable[[int], str]) -> None:
    """Raise UnreachableError for the first phase whose end no configuration reaches, on whatever branch."""
    for index, way in enumerate(ways):
        if way.pieces and not isinstance(way, PoseTrack):  # of which it is said where it breaks off
            with _blamed(blame(index)):
                solve(arm, way.end, seed, candidates=1)


@contextmanager
def _blamed(key: str) -> Iterator[None]:
    """Let what cannot be reached within begin with a key."""
    try:
        yield
    except UnreachableError as error:
        raise UnreachableError(f"{key}: {error}", error.closest) from error


def _configurations(arm: Arm, start: Pose, nearest: Array, led: Array) -> Iterator[Array]:
    """Yield start configurations; those beside the nearest are found once somebody asks for them."""
    yield nearest
    rng = np.random.default_rng(0)
    found = [nearest]
    for _ in range(_START_CONFIGURATIONS):
        seed = rng.uniform(np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi))
        try:
            q = solve(arm, start, seed, led=led).q
        except UnreachableError:
            continue
        if all(np.abs(q - other).max() > 1e-3 for other in found):
            found.append(q)
    yield from sorted(found[1:], key=lambda q: float(np.linalg.norm(q - arm.home)))


def _follow_all(
    arm: Arm, ways: list[planning.AnyWay], q: Array, blame: Callable[[int], str], led: Sequence[Array]
) -> tuple[JointPath, ...]:
    paths: list[JointPath] = []
    for index, (way, asked) in enumerate(zip(ways, led, strict=False)):
        if isinstance(way, PoseTrack):
            paths.append(track_joints(arm, way, q, blame(index), asked))
            q = paths[-1].last
            continue
        count = max(way.pieces * (_FINER if way.even else 1), _led_pieces(q, asked))
        if count == 0:
            paths.append(JointPath(q, None))
            continue
        shares = [k / count for k in range(1, count + 1)]
        poses = [way.at(share) for share in shares]
        with _blamed(blame(index)):
            knots = np.concatenate([q[None], follow(arm, poses, q, _led_through(q, asked, shares))])
        paths.append(JointPath(q, _spline(arm, way, knots, np.isnan(asked))))
        q = paths[-1].last
    return tuple(paths)


def _led_pieces(q: Array, led: Array) -> int:
    """Return into how many pieces a motion is cut for the joints that are led; 0 where none moves."""
    farthest = float(np.nan_to_num(np.abs(led - q)).max())
    return 0 if farthest == 0.0 else max(4, math.ceil(farthest / _LED_STEP))


def _led_through(q: Array, led: Array | None, shares: Sequence[float]) -> Array | None:
    """Return where joints are led (shares, joints) at shares of their way from q; None where none is."""
    if led is None or np.isnan(led).all():
        return None
    return np.asarray(q + np.array(shares)[:, None] * (led - q))


def _spline(arm: Arm, way: FlangeWay, knots: Array, free: Mask) -> CubicSpline:
    """Return the joint angles over the fraction of the way, through equally spaced knots (k, joints) [rad].

    Where the ends are not at rest, the flange's velocity there is exactly the way's: motions that follow one
    another at the same pace do so without a jump. Only joints that are free are corrected for it.
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
    return CubicSpline(fractions, knots, bc_type=((1, slopes[0]), (1, slopes[1])))
