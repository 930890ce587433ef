"""Motions in time, without an engine: ramps, shakes, poses of the flange, joints of arm and cell, tip paths.

How a phase goes from its first to its last value: progress s from 0 to 1 over the ramp's time.

A shaking motion of the flange through a phase.

From a scenario's flange poses and motions to rigid transforms.

Joint angles through a phase.

Where the joints of a cell are asked to be through the phases.

Paths of the tip, as they have been planned and as they are passed in a run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.frames import (
    Array,
    IntArray,
    Mask,
    Pose,
    cross_matrix,
    rotation_from_vector,
    vector_from_rotation,
)
from cosim.base.tip_course import CourseInstant, TipCourse
from cosim.config.schema.phase import CELL_KEYS, FlangePoseTable, FlangeTurnTable, PhaseTable
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Fault, Faults

if TYPE_CHECKING:
    from cosim.rigid.build.description import CellJoint


_ROUNDING = 1e-12  # of an instant that is a whole number of ticks


@final
@dataclass(frozen=True)
class Progress:
    """Progress of a ramp at one instant.

    Args:
        value: s, 0 to 1.
        rate: ds/dt [1/s].
        acceleration: d2s/dt2 [1/s^2].
    """

    value: float
    rate: float
    acceleration: float


def progress(kind: Literal["smooth", "linear", "step"], time_s: float, duration_s: float) -> Progress:
    """Return the progress of a ramp.

    smooth (minimum jerk): s = 10 u^3 - 15 u^4 + 6 u^5 with u = t / duration; linear: s = u;
    step: s = 1 from t > 0. Where rate or acceleration jumps, at the ends of a linear ramp, they are those of
    the time after: the start belongs to the ramp, the end to what follows it.
    Source: Flash and Hogan, J. Neurosci. 5 (1985) 1688, for the minimum-jerk polynomial.

    Args:
        kind: of the ramp.
        time_s: since the phase began.
        duration_s: of the ramp.
    """
    if time_s < 0.0 or (time_s == 0.0 and kind != "linear"):
        return Progress(0.0, 0.0, 0.0)
    if time_s >= duration_s * (1.0 - _ROUNDING) or kind == "step":
        return Progress(1.0, 0.0, 0.0)
    u = time_s / duration_s
    if kind == "linear":
        return Progress(u, 1.0 / duration_s, 0.0)
    value = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    rate = 30.0 * u * u * (1.0 - u) ** 2 / duration_s
    acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration_s**2
    return Progress(value, rate, acceleration)


_PIECES_PER_CYCLE = 24


@final
@dataclass(frozen=True)
class Shake:
    """u(s) = amplitude w(s) sin(2 pi cycles s); w rises smoothly in the first cycle and falls in the last.

    Args:
        amplitude: (3,) [m], world.
        cycles: in the whole phase.
    """

    amplitude: Array
    cycles: float

    @classmethod
    def of(cls, phase: PhaseTable) -> Shake | None:
        """Return that of a phase, None where it does not shake."""
        given = phase.flange_shake
        if given is None:
            return None
        axis = np.array(given.axis)
        return cls(given.amplitude_m / np.linalg.norm(axis) * axis, given.frequency_Hz * phase.duration_s)

    def at(self, fraction: float) -> Array:
        """Return the displacement (3,) [m] at a fraction of the phase."""
        from_end = self.cycles * min(fraction, 1.0 - fraction)
        fade = progress("smooth", from_end, 1.0).value
        return np.asarray(fade * math.sin(2.0 * math.pi * self.cycles * fraction) * self.amplitude)

    @property
    def pieces(self) -> int:
        """Into how many small motions it is cut."""
        return math.ceil(_PIECES_PER_CYCLE * self.cycles)


_DOWN = np.array([0.0, 0.0, -1.0])
_HANGING = np.diag([1.0, -1.0, -1.0])
_HALF_TURN_ABOUT_Y = np.diag([-1.0, 1.0, -1.0])
_KNOT_TURN_RAD = 0.05
_KNOT_SHIFT_M = 0.02
_OPPOSITE = 1e-9
"""1 + cosine below which the shortest turn has no unique axis."""


def rotation_from_direction(direction: Array, roll_rad: float = 0.0) -> Array:
    """Return the flange's rotation, world from flange, whose z axis is `direction`.

    R = R_shortest(down -> direction) R_hanging R_z(roll), where R_hanging has z down and x along the
    world's x axis, and R_shortest = I + S + S^2 / (1 + c) with S = [down x direction] and
    c = down . direction; straight up, half a turn about the world's y axis.

    Args:
        direction: (3,), not zero, world; normalised here.
        roll_rad: about the flange's z axis.
    """
    unit = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    skew, cosine = cross_matrix(np.cross(_DOWN, unit)), float(_DOWN @ unit)
    if 1.0 + cosine < _OPPOSITE:
        shortest = _HALF_TURN_ABOUT_Y
    else:
        shortest = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
    return np.asarray(shortest @ _HANGING @ rotation_from_vector(np.array([0.0, 0.0, roll_rad])))


def pose_of(flange: FlangePoseTable) -> Pose:
    """Return the pose, world from flange, that a scenario's `flange` table describes."""
    rotation = rotation_from_direction(np.array(flange.direction), flange.roll_rad)
    return Pose(rotation, np.array(flange.position_m))


@final
@dataclass(frozen=True)
class FlangeWay:
    """A motion of the flange: its origin on a line, its rotation about one world axis.

    Args:
        begin: world from flange, at fraction 0.
        turn: (3,) [rad], axis times angle; may exceed half a turn.
        shift: (3,) [m].
        shake: on top; None for none.
        even: whether it is run through at an even pace, so that its ends are not at rest.
    """

    begin: Pose
    turn: Array
    shift: Array
    shake: Shake | None = None
    even: bool = False

    @classmethod
    def to(cls, begin: Pose, end: Pose) -> FlangeWay:
        """Return the shortest way from one pose to another."""
        turn = vector_from_rotation(end.rotation @ begin.rotation.T)
        return cls(begin, turn, end.translation - begin.translation)

    def at(self, fraction: float) -> Pose:
        """Return world_from_flange at a fraction of the way."""
        rotation = rotation_from_vector(fraction * self.turn) @ self.begin.rotation
        place = self.begin.translation + fraction * self.shift
        return Pose(rotation, place if self.shake is None else place + self.shake.at(fraction))

    @classmethod
    def relative(
        cls, begin: Pose, turn: FlangeTurnTable | None, shift_m: Array | None, shake: Shake | None = None
    ) -> FlangeWay:
        """Return a turn about the flange's own origin, a shift and a shake, along world axes."""
        vector = np.zeros(3)
        if turn is not None:
            vector = turn.angle_rad / np.linalg.norm(turn.axis) * np.array(turn.axis)
        return cls(
            begin, vector, np.zeros(3) if shift_m is None else np.asarray(shift_m, dtype=np.float64), shake
        )

    @property
    def rate_at_ends(self) -> Array:
        """d(linear, angular)/d(share) (6,) [m, rad], world axes, at both ends: a shake rests there."""
        return np.concatenate([self.shift, self.turn])

    @property
    def end(self) -> Pose:
        """World from flange at fraction 1."""
        return self.at(1.0)

    @property
    def pieces(self) -> int:
        """Into how many small motions the way is cut; 0 where nothing moves."""
        turn, shift = float(np.linalg.norm(self.turn)), float(np.linalg.norm(self.shift))
        shaken = 0 if self.shake is None else self.shake.pieces
        if turn < 1e-12 and shift < 1e-12 and not shaken:
            return 0
        return max(4, shaken, math.ceil(turn / _KNOT_TURN_RAD), math.ceil(shift / _KNOT_SHIFT_M))


_FEW: Final = 4
"""Instants that are worked out faster than compared."""


@final
@dataclass(frozen=True)
class JointReference:
    """What is asked of an arm's joints, at one instant or at n.

    Args:
        position: (joints,) or (n, joints) [rad].
        velocity: the same [rad/s].
        acceleration: the same [rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array

    def row(self, k: int) -> JointReference:
        """Return what is asked at one of several instants."""
        return JointReference(self.position[k], self.velocity[k], self.acceleration[k])

    def as_rows(self) -> JointReference:
        """Return what is asked at one instant as that of one row."""
        return JointReference(self.position[None], self.velocity[None], self.acceleration[None])

    def some(self, k: int, end: int | None) -> JointReference:
        """Return what is asked at some of several instants, from one on."""
        return JointReference(self.position[k:end], self.velocity[k:end], self.acceleration[k:end])

    def distinct(self) -> tuple[Mask | slice, IntArray | slice]:
        """Return the instants to work out, and which of those each is: one for all while the arm stands."""
        if len(self.position) <= _FEW:
            return slice(None), slice(None)
        parts = self.position, self.velocity, self.acceleration
        changes = np.logical_or.reduce([part[1:] != part[:-1] for part in parts])
        new = np.concatenate([[True], changes.any(axis=1)])
        return new, np.cumsum(new) - 1


@final
@dataclass(frozen=True)
class JointPath:
    """Joint angles over the progress s of a phase.

    Args:
        first: (joints,) [rad], at s = 0.
        spline: cubic over s, or None where the arm stands still.
    """

    first: Array
    spline: CubicSpline | None

    @property
    def last(self) -> Array:
        """(joints,) [rad], at s = 1."""
        return self.first if self.spline is None else np.asarray(self.spline(1.0))

    def at(self, progress: Progress) -> JointReference:
        """Return what is asked for at one instant."""
        return self.through([progress]).row(0)

    def through(self, instants: Sequence[Progress]) -> JointReference:
        """Return what is asked for at some instants; together they cost a fraction of one by one."""
        if self.spline is None:
            still = np.zeros((len(instants), len(self.first)))
            return JointReference(still + self.first, still, still)
        s, rate, acceleration = np.array([(p.value, p.rate, p.acceleration) for p in instants]).T[..., None]
        q, slope, curve = (np.asarray(self.spline(s[:, 0], order)) for order in range(3))
        return JointReference(q, slope * rate, curve * rate**2 + slope * acceleration)


_SLIDING: Final = ("cell_shift_m", "cell_speed_m_s")


@final
@dataclass(frozen=True)
class _Stretch:
    """A joint through a phase: a ramp to a place, or an even speed; the other is zero.

    Args:
        begin: [m] or [rad].
        change: over the ramp [m] or [rad].
        speed: [m/s] or [rad/s].
        ramp: of the phase.
        ramp_s: its length.
    """

    begin: float
    change: float
    speed: float
    ramp: Literal["smooth", "linear", "step"]
    ramp_s: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return place and speed."""
        now = progress(self.ramp, time_s, self.ramp_s)
        return self.begin + self.change * now.value + self.speed * time_s, self.change * now.rate + self.speed


@final
@dataclass(frozen=True)
class CellMotion:
    """The joints of a cell through a run.

    Args:
        stretches: by phase and joint.
    """

    stretches: tuple[tuple[_Stretch, ...], ...]

    def at(self, phase: int, time_s: float) -> tuple[Array, Array]:
        """Return places (joints,) [m] or [rad] and speeds (joints,) some time after a phase began."""
        found = [stretch.at(time_s) for stretch in self.stretches[phase]]
        return np.array([place for place, _ in found]), np.array([speed for _, speed in found])


def cell_motion(
    phases: Sequence[PhaseTable], joints: Sequence[CellJoint], lengths_s: Sequence[float]
) -> CellMotion:
    """Return how phases drive the joints of a cell: a place or a speed stays what it is until it is changed.

    Args:
        phases: of the scenario.
        joints: of the cell.
        lengths_s: of the phases, in whole ticks.

    Raises:
        ScenarioError: there is no such joint, it slides where it is to turn, or it would leave its limits.
    """
    places, speeds, faults = [0.0] * len(joints), [0.0] * len(joints), Faults()
    beyond: set[str] = set()
    rows = []
    for phase, length_s in zip(phases, lengths_s, strict=True):
        _check_names(phase, joints, faults)
        row = []
        for k, joint in enumerate(joints):
            to, speed = _asked(phase, joint)
            if to is not None:
                speeds[k] = 0.0
            elif speed is not None:
                speeds[k] = speed
            change = 0.0 if to is None else to - places[k]
            row.append(_Stretch(places[k], change, speeds[k], phase.ramp, phase.duration_s))
            places[k] = row[-1].at(max(length_s, phase.duration_s))[0]
            low, high = joint.limits
            if not low <= places[k] <= high and joint.name not in beyond:
                faults.add(*_out_of_range(phase, joint, places[k]))
                beyond.add(joint.name)
        rows.append(tuple(row))
    faults.raise_all()
    return CellMotion(tuple(rows))


def _asked(phase: PhaseTable, joint: CellJoint) -> tuple[float | None, float | None]:
    """Return the place and the speed that a phase asks of a joint."""
    places, speeds = phase.cell_angle_rad, phase.cell_speed_rad_s
    if joint.slides:
        places, speeds = phase.cell_shift_m, phase.cell_speed_m_s
    return (places or {}).get(joint.name), (speeds or {}).get(joint.name)


def _check_names(phase: PhaseTable, joints: Sequence[CellJoint], faults: Faults) -> None:
    named: set[str] = set()
    for key in CELL_KEYS:
        fitting = tuple(joint.name for joint in joints if joint.slides == (key in _SLIDING))
        for name in getattr(phase, key) or {}:
            where = f"phase.{phase.name}.{key}.{name}"
            if name not in fitting:
                kind = "slide of the cell" if key in _SLIDING else "hinge of the cell"
                faults.add(where, unknown_name_message(kind, name, fitting))
            elif name in named:
                faults.add(where, "is given a place and a speed in one phase; one of them drives it")
            named.add(name)


def _out_of_range(phase: PhaseTable, joint: CellJoint, place: float) -> Fault:
    """Return what is wrong where a phase leads a joint out of its limits."""
    (low, high), unit = joint.limits, "m" if joint.slides else "rad"
    keys = [key for key in CELL_KEYS if joint.name in (getattr(phase, key) or {})]
    where = f"phase.{phase.name}.{keys[0]}.{joint.name}" if keys else f"phase.{phase.name}"
    return Fault(
        where, f"takes the cell's joint to {place:g} {unit}; its range is {low:g} to {high:g} {unit}"
    )


@final
@dataclass(frozen=True)
class TipErrors:
    """How far a tip is from where it is to be, along a path.

    Args:
        largest_m: distance.
        mean_m: distance.
        at_m: of path, where the distance is largest.
        largest_rad: angle; 0 where the direction is free.
    """

    largest_m: float
    mean_m: float
    at_m: float
    largest_rad: float

    @classmethod
    def of(cls, wanted: CourseInstant, position: Array, direction: Array) -> TipErrors:
        """Return those of n tips (n, 3) [m] with directions (n, 3), against where they are to be."""
        away, turned = tip_distances(wanted, position, direction)
        place = int(np.argmax(away))
        return cls(float(away[place]), float(away.mean()), float(wanted.along_m[place]), float(turned.max()))

    def figures(self) -> dict[str, float]:
        """Return them for the summary."""
        return {
            "largest_error_m": self.largest_m,
            "mean_error_m": self.mean_m,
            "largest_error_at_m": self.at_m,
            "largest_angle_rad": self.largest_rad,
        }


def tip_distances(wanted: CourseInstant, position: Array, direction: Array) -> tuple[Array, Array]:
    """Return by how far (n,) [m] and by what angles (n,) [rad] tips are off; see `TipErrors.of`."""
    away = np.linalg.norm(position - wanted.position, axis=1)
    if wanted.direction is None:
        return away, np.zeros(len(away))
    sine = np.linalg.norm(np.cross(direction, wanted.direction), axis=1)
    return away, np.arctan2(sine, (direction * wanted.direction).sum(axis=1))


@final
@dataclass(frozen=True)
class PlannedTipPath:
    """A path of the tip, planned on the statics with gravity less the path's own acceleration.

    Args:
        course: where the tip is to be, and when.
        compensated: errors that the plan leaves.
        uncompensated: errors with the flange where a straight arm would be on the path; None where that arm
            has no equilibria all along it.
    """

    course: TipCourse
    compensated: TipErrors
    uncompensated: TipErrors | None


@final
@dataclass(frozen=True)
class TipPathInfo:
    """When a run passes a path.

    Args:
        planned: the path.
        begin_s: simulated time.
        lasts_s: simulated time from its begin to its end.
    """

    planned: PlannedTipPath
    begin_s: float
    lasts_s: float

    def at(self, time_s: Array) -> CourseInstant:
        """Return where the tip is to be at instants (n,) [s] of the run."""
        course = self.planned.course
        return course.at((time_s - self.begin_s) / self.lasts_s * course.duration_s)

    def passes(self, time_s: Array) -> Mask:
        """Return at which instants (n,) [s] of the run, in the phase, the path is being passed."""
        return np.asarray(time_s <= self.begin_s + self.lasts_s * (1.0 + 1e-9))
