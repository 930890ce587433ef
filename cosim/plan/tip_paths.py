"""Finds the flange's motion with the deformed tip on a path, on the statics. For each instant the flange
first moves as if the tip was fixed to it; then Gauss-Newton steps with the exact sensitivities bring the tip
onto the path. Of all flange motions that do, the smallest is used, so free components (the roll about the
tip, or its direction) change as little as possible. A moving arm has the effective gravity g - a - c v, with
the path's acceleration a, its velocity v and the air drag c.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias, final

import numpy as np

from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array, Pose, rotation_from_quaternion, rotation_from_vector
from cosim.base.tip_course import CourseInstant, TipCourse
from cosim.config.schema.phase import TipPathTable
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.errors import CosimError, InputError, SolverError, UnreachableError
from cosim.plan.flange_motion import FlangeMotion
from cosim.plan.straight_arm import StraightArm
from cosim.plan.tip_errors import PlannedTipPath, TipErrors, tip_distances
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_target import TargetOptions, TipTarget, shortest_turn

_KNOT_s: Final = 0.02  # of the joints' spline
_PER_RAMP: Final = 10
_FEWEST, _MOST = 50, 2000  # of its knots
_STEP_m: Final = 8e-3  # of path from one instant to the next
_TURN_rad: Final = 0.06
_APPROACH: Final = 12  # load steps to the start pose of a straight arm
_BEGINS_WITHIN: Final = (1e-4, 2e-3)  # m, rad
_FELT_m_s2: Final = 0.5  # accelerations below this, a twentieth of gravity, bend an arm little
_CLOSELY: Final = TargetOptions(position_tolerance_m=1e-6, angle_tolerance_rad=1e-5)
"""Tight, because errors at instants some hundredths of a second apart would appear as accelerations."""
_Next = Callable[[Equilibrium, CourseInstant, CourseInstant, Loads], Equilibrium]


@final
class PoseTrack:
    """A motion of the flange from rest to rest: cubic splines through positions and quaternions over time.

    Args:
        time_s: (k,), from 0 on, increasing.
        poses: k, world from flange.
        course: target of the tip over time.
    """

    even: Final = False

    def __init__(self, time_s: Array, poses: Sequence[Pose], course: TipCourse) -> None:
        rows = np.array([[*pose.translation, *pose.quaternion] for pose in poses])
        for k in range(1, len(rows)):  # a quaternion and its opposite are one rotation
            if rows[k, 3:] @ rows[k - 1, 3:] < 0.0:
                rows[k, 3:] *= -1.0
        self._end_s = float(time_s[-1])
        self._spline = CubicSpline(time_s, rows, (0.0, 0.0))
        self.begin, self.end, self.course = poses[0], poses[-1], course

    def at(self, fraction: float) -> Pose:
        """Return world_from_flange at a fraction of the time."""
        row = self._spline(fraction * self._end_s)
        return Pose(rotation_from_quaternion(row[3:] / np.linalg.norm(row[3:])), row[:3])

    @property
    def pieces(self) -> int:
        """Number of steps of inverse kinematics along the motion."""
        return min(max(_FEWEST, math.ceil(self._end_s / min(_KNOT_s, self.course.ramp_s / _PER_RAMP))), _MOST)

    def instant(self, fraction: float) -> CourseInstant:
        """Return the tip's target at a fraction of the time."""
        return self.course.at(fraction * self.course.duration_s)


AnyFlangeMotion: TypeAlias = FlangeMotion | PoseTrack


@final
@dataclass(frozen=True)
class PhaseMotion:
    """A phase solved on the statics.

    Args:
        way: motion of the flange.
        end: equilibrium at its end.
        path: of the tip; None without one.
    """

    way: AnyFlangeMotion
    end: Equilibrium
    path: PlannedTipPath | None = None


def follow_path(
    soft: SoftRobot, begin: Equilibrium, loads: Loads, path: TipPathTable, air_drag_per_s: float | None
) -> PhaseMotion:
    """Return the flange's motion along a path, and the equilibrium that it ends in.

    Args:
        soft: soft side whose equilibria are solved.
        begin: equilibrium with the tip on the path's first point.
        loads: at the end; they change linearly with time.
        path: to follow.
        air_drag_per_s: c; None in statics, without accelerations.

    Raises:
        UnreachableError: the tip does not begin on the path, or cannot follow it.
        ConvergenceError: the equilibrium was lost along the path.
    """
    trip = _Trip(soft, path.course(), begin.loads, loads, air_drag_per_s)
    if path.reach_with == "none":
        states = trip.straight(_straight_at(begin, trip.instants), begin)
        errors = trip.errors(states)
        return PhaseMotion(trip.track(states), states[-1], PlannedTipPath(trip.course, errors, errors))
    tip = _begin_tip(soft, begin, trip.instants)
    straight = StraightArm.of(soft.body, begin.state.positions)
    uncompensated = trip.uncompensated(straight, begin)
    states = trip.through(begin, lambda *step: _onto(soft, *step), trip.beginning_at(tip))
    planned = PlannedTipPath(trip.course, trip.errors(states), uncompensated)
    return PhaseMotion(trip.track(states), states[-1], planned)


@final
class _Trip:
    """Solves the equilibria at the instants of a course.

    Args:
        soft: soft side whose equilibria are solved.
        course: target of the tip over time.
        begin: loads at its start.
        end: loads at its end.
        air_drag_per_s: c; None in statics.
    """

    def __init__(
        self, soft: SoftRobot, course: TipCourse, begin: Loads, end: Loads, air_drag_per_s: float | None
    ) -> None:
        self.course = course
        self._soft = soft
        self._time_s = course.knots(_STEP_m, _TURN_rad, _PER_RAMP)
        self.instants = course.at(self._time_s)
        self._loads = [self._load(begin, end, k, air_drag_per_s) for k in range(len(self._time_s))]

    def _load(self, begin: Loads, end: Loads, k: int, air_drag_per_s: float | None) -> Loads:
        if k == len(self._time_s) - 1:
            return end
        load = begin.interpolated(end, self._time_s[k] / self._time_s[-1])
        if air_drag_per_s is None:
            return load
        felt = self.instants.acceleration[k] + air_drag_per_s * self.instants.velocity[k]
        x, y, z = (np.array(load.gravity) - felt).tolist()
        return replace(load, gravity=(x, y, z))

    def beginning_at(self, tip: TipFrame) -> CourseInstant:
        """Return targets for a tip that is slightly off the path at first, and on it after the first ramp."""
        first, since = self.instants.row(0), np.minimum(self._time_s / self.course.ramp_s, 1.0)
        beside = 1.0 - since**3 * (10.0 - 15.0 * since + 6.0 * since**2)
        place = self.instants.position + beside[:, None] * (tip.position - first.position)
        direction = self.instants.direction
        if direction is not None and first.direction is not None:
            turn = shortest_turn(first.direction, tip.direction)
            direction = np.array(
                [rotation_from_vector(b * turn) @ d for b, d in zip(beside, direction, strict=True)]
            )
        return replace(self.instants, position=place, direction=direction)

    def through(
        self, begin: Equilibrium, step: _Next, asked: CourseInstant | None = None
    ) -> list[Equilibrium]:
        """Return the equilibria at all instants, each solved from the one before.

        Args:
            begin: equilibrium at the first instant.
            step: solves the next equilibrium.
            asked: targets at the instants, in place of those of the course.
        """
        path = asked or self.instants
        states = [begin]
        for k in range(1, len(self._time_s)):
            try:
                states.append(step(states[-1], path.row(k - 1), path.row(k), self._loads[k]))
            except CosimError as error:
                raise _placed(error, self.instants.row(k)) from error
        return states

    def track(self, states: list[Equilibrium]) -> PoseTrack:
        """Return the motion of the flange through equilibria."""
        return PoseTrack(self._time_s, [state.world_from_flange for state in states], self.course)

    def errors(self, states: list[Equilibrium]) -> TipErrors:
        """Return the errors of the tips of equilibria."""
        tips = [TipFrame.of(self._soft.body, state.state.positions) for state in states]
        return TipErrors.of(
            self.instants, np.array([t.position for t in tips]), np.array([t.direction for t in tips])
        )

    def straight(self, arm: StraightArm, begin: Equilibrium) -> list[Equilibrium]:
        """Return the equilibria with the flange where a straight arm would have it."""

        def moved(here: Equilibrium, _: CourseInstant, wanted: CourseInstant, loads: Loads) -> Equilibrium:
            pose = arm.pose(here.world_from_flange, wanted.position, wanted.direction)
            return self._soft.follow(here, pose, loads)

        return self.through(begin, moved)

    def uncompensated(self, arm: StraightArm, begin: Equilibrium) -> TipErrors | None:
        """Return the errors of the tip if the flange moves as for a straight arm; None without equilibria."""
        soft = self._soft
        try:
            wanted = self.instants.row(0)
            pose = arm.pose(begin.world_from_flange, wanted.position, wanted.direction)
            first = begin
            for fraction in np.linspace(0.0, 1.0, _APPROACH + 1)[1:].tolist():
                between = begin.world_from_flange.interpolated(pose, fraction)
                first = soft.follow(first, between, begin.loads)
            moved = self.straight(arm, first)
        except SolverError:
            return None
        return self.errors(moved)


def _straight_at(begin: Equilibrium, instants: CourseInstant) -> StraightArm:
    """Return the straight arm whose tip is on the path's first point.

    Raises:
        UnreachableError: the first point is not on the flange's z axis.
    """
    first, flange = instants.row(0), begin.world_from_flange
    way = first.position - flange.translation
    axis = flange.rotation[:, 2]
    turned = 0.0 if first.direction is None else np.linalg.norm(shortest_turn(axis, first.direction))
    if np.linalg.norm(way - (way @ axis) * axis) > _BEGINS_WITHIN[0] or turned > _BEGINS_WITHIN[1]:
        remedy = _remedy(first, ", reach_with = 'none'")
        raise UnreachableError(
            f"with reach_with = 'none' a straight arm begins on the path, and this one does not; {remedy}"
        )
    return StraightArm(float(way @ axis))


def _onto(
    soft: SoftRobot, here: Equilibrium, before: CourseInstant, after: CourseInstant, loads: Loads
) -> Equilibrium:
    """Return the equilibrium with the tip on the target of the next instant."""
    turn, pose = np.eye(3), here.world_from_flange
    if before.direction is not None and after.direction is not None:
        turn = rotation_from_vector(shortest_turn(before.direction, after.direction))
    carried = Pose(turn @ pose.rotation, after.position + turn @ (pose.translation - before.position))
    found = soft.follow(here, carried, loads)
    return soft.find_flange_pose(found, TipTarget(after.position, after.direction), _CLOSELY)


def _begin_tip(soft: SoftRobot, begin: Equilibrium, instants: CourseInstant) -> TipFrame:
    """Return the tip at the start.

    Raises:
        UnreachableError: it is not on the path's first point.
    """
    tip, first = TipFrame.of(soft.body, begin.state.positions), instants.row(0)
    (away,), (turned,) = tip_distances(first, tip.position[None], tip.direction[None])
    if away <= _BEGINS_WITHIN[0] and turned <= _BEGINS_WITHIN[1]:
        return tip
    place = np.round(tip.position, 4).tolist()
    raise UnreachableError(
        f"begins {1e3 * away:.4g} mm and {np.degrees(turned):.3g} degrees off the tip, which is at {place} "
        f"m then; {_remedy(instants.row(0))}"
    )


def _remedy(first: CourseInstant, further: str = "") -> str:
    """Return a text with the `tip_target` that brings the tip to the first point, with `further` keys."""
    direction = ""
    if first.direction is not None:
        direction = f", direction = {np.round(first.direction, 5).tolist()}"
    return (
        "bring it there in a phase before: tip_target = { position_m = "
        f"{np.round(first.position, 5).tolist()}{direction}{further} }}"
    )


def _placed(error: CosimError, instant: CourseInstant) -> CosimError:
    """Return the error with the place along the path in front of its message."""
    text, felt = f"{instant}: {error}", float(np.linalg.norm(instant.acceleration))
    if felt > _FELT_m_s2:
        text += (
            f"; the path accelerates by {felt:.3g} m/s^2 there: a lower speed_m_s or a longer ramp_s eases it"
        )
    if isinstance(error, InputError):
        return UnreachableError(text)
    error.args = (text, *error.args[1:])
    return error
