"""A curve that a tip follows, and when it is where: one time law over the whole path."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np

from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array
from cosim.errors import InputError

_PIECES: Final = 16  # of the stretch between two points, over which the length is summed up
_WIDEST_rad: Final = 0.5 * np.pi
_SMALLEST_m: Final = 1e-6


@final
@dataclass(frozen=True)
class CourseInstant:
    """Where the tip is to be, at one instant or at n.

    Args:
        along_m: () or (n,) [m], of the path behind it.
        position: (3,) or (n, 3) [m], world.
        direction: the same, unit vectors, world; None where it is free.
        velocity: the same [m/s].
        acceleration: the same [m/s^2].
    """

    along_m: Array
    position: Array
    direction: Array | None
    velocity: Array
    acceleration: Array

    def row(self, k: int) -> "CourseInstant":
        """Return one of several instants."""
        return CourseInstant(
            self.along_m[k], self.position[k], None if self.direction is None else self.direction[k],
            self.velocity[k], self.acceleration[k],
        )  # fmt: skip

    def __str__(self) -> str:
        """Return where an instant is along the path."""
        place = np.round(self.position, 4).tolist()
        return f"{1e3 * float(self.along_m):.1f} mm along the path, with the tip at {place} m"


@final
class TipCourse:
    """A smooth curve through points, passed from rest to rest at one speed.

    The curve is the cubic spline through the points over the sum of their distances (straight through two);
    directions are splined likewise and normalised. With u = t / ramp the speed rises as
    v (10 u^3 - 15 u^4 + 6 u^5), so that the path behind is v ramp (5 u^4 / 2 - 3 u^5 + u^6); it falls
    alike at the end. The whole takes length / v + ramp.

    Args:
        points: (n, 3) [m], world; at least two.
        directions: (n, 3) or (1, 3), world; (0, 3) leaves the direction free.
        speed_m_s: v.
        ramp_s: from rest to v, and from v to rest.

    Raises:
        InputError: the points or directions make no such curve, or it is too short to reach the speed.
    """

    def __init__(self, points: Array, directions: Array, speed_m_s: float, ramp_s: float) -> None:
        self.speed_m_s, self.ramp_s = speed_m_s, ramp_s
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if len(points) < 2 or steps.min() < _SMALLEST_m:
            place = int(np.argmin(steps)) + 2 if len(steps) else 1
            raise InputError(
                f"point {place} is the same as the one before it; a path has two points at least, and each "
                "lies beyond the last"
            )
        chord = np.concatenate([[0.0], np.cumsum(steps)])
        fine = np.concatenate(
            [np.linspace(a, b, _PIECES, endpoint=False) for a, b in pairwise(chord.tolist())] + [chord[-1:]]
        )
        curve = CubicSpline(chord, points)
        along = np.concatenate([[0.0], np.cumsum(_lengths(curve, fine))])
        self.length_m = float(along[-1])
        self._position = CubicSpline(along, curve(fine))
        self._direction = _direction_over(along, fine, chord, directions)
        if self.length_m < speed_m_s * ramp_s:
            raise InputError(
                f"is {1e3 * self.length_m:.4g} mm long, too short to reach {speed_m_s:g} m/s and to rest "
                f"again in ramps of {ramp_s:g} s, which take {1e3 * speed_m_s * ramp_s:.4g} mm; give a "
                f"speed_m_s of at most {self.length_m / ramp_s:.3g}, or a ramp_s of at most "
                f"{self.length_m / speed_m_s:.3g}"
            )

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.length_m / self.speed_m_s + self.ramp_s

    def at(self, time_s: float | Array) -> CourseInstant:
        """Return where the tip is to be; before and after the path it rests at its ends.

        Args:
            time_s: () or (n,), since it began.
        """
        along, rate, change = self._passed(np.asarray(time_s, dtype=np.float64))
        slope, curve = self._position(along, 1), self._position(along, 2)
        return CourseInstant(
            along, self._position(along), self.direction(along), slope * rate[..., None],
            curve * (rate**2)[..., None] + slope * change[..., None],
        )  # fmt: skip

    def direction(self, along_m: Array) -> Array | None:
        """Return unit vectors (..., 3) at lengths of path; None where they are free."""
        if self._direction is None:
            return None
        found = self._direction(along_m)
        return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))

    def knots(self, step_m: float, turn_rad: float, per_ramp: int) -> Array:
        """Return instants (k,) [s], from the begin to the end, between which the path is nearly even.

        Args:
            step_m: of path between two, at most.
            turn_rad: of its tangent or direction between two, on average.
            per_ramp: pieces of either ramp.
        """
        even_m = self.length_m - self.speed_m_s * self.ramp_s
        count = max(4, int(np.ceil(even_m / step_m)), int(np.ceil(self._turning() / turn_rad)))
        ramp, end_s = np.linspace(0.0, self.ramp_s, per_ramp + 1), self.duration_s
        between = np.linspace(self.ramp_s, end_s - self.ramp_s, count + 1)[1:-1]
        if even_m < 1e-3 * step_m:
            return np.concatenate([ramp, end_s - ramp[-2::-1]])
        return np.concatenate([ramp, between, end_s - ramp[::-1]])

    def _turning(self) -> float:
        """Return the angle [rad] by which tangent and direction turn, the larger of both."""
        along = np.linspace(0.0, self.length_m, 400)
        tangent = self._position(along, 1)
        rows = [tangent / np.linalg.norm(tangent, axis=1, keepdims=True), self.direction(along)]
        sums = [np.linalg.norm(np.diff(row, axis=0), axis=1).sum() for row in rows if row is not None]
        return float(max(sums))

    def _passed(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Return the path behind [m], its rate [m/s] and the rate of that [m/s^2]."""
        end_s, v, ramp = self.duration_s, self.speed_m_s, self.ramp_s
        t = np.clip(time_s, 0.0, end_s)
        u = np.minimum(np.minimum(t, end_s - t) / ramp, 1.0)
        late = t > 0.5 * end_s
        begun = v * ramp * u**4 * (2.5 - 3.0 * u + u * u)
        even = np.where(late, self.length_m - begun, begun)
        middle = (t > ramp) & (t < end_s - ramp)
        along = np.where(middle, v * (t - 0.5 * ramp), even)
        rate = v * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        change = np.where(late, -1.0, 1.0) * v / ramp * 30.0 * u * u * (1.0 - u) ** 2
        return along, rate, change


def course_of(
    points: Sequence[Sequence[float]], directions: Sequence[Sequence[float]], speed_m_s: float, ramp_s: float
) -> TipCourse:
    """Return the course of lists of points and directions; see `TipCourse`."""
    return TipCourse(np.array(points).reshape(-1, 3), np.array(directions).reshape(-1, 3), speed_m_s, ramp_s)


def _lengths(curve: CubicSpline, fine: Array) -> Array:
    """Return the lengths (k - 1,) [m] of a curve between places (k,), by five points of Gauss."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    half = 0.5 * np.diff(fine)
    places = (0.5 * (fine[:-1] + fine[1:]))[:, None] + half[:, None] * nodes
    return np.asarray(half * (np.linalg.norm(curve(places, 1), axis=-1) @ weights))


def _direction_over(along: Array, fine: Array, chord: Array, directions: Array) -> CubicSpline | None:
    """Return directions over the length of path, not normalised."""
    if not len(directions):
        return None
    if len(directions) not in (1, len(chord)):
        raise InputError(
            f"has {len(directions)} directions; give one, or one for each of {len(chord)} points"
        )
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    if len(unit) == 1:
        return CubicSpline(along[[0, -1]], np.repeat(unit, 2, axis=0))
    between = np.arccos(np.clip((unit[1:] * unit[:-1]).sum(axis=1), -1.0, 1.0))
    widest = int(np.argmax(between))
    if between[widest] > _WIDEST_rad:
        raise InputError(
            f"turns by {np.degrees(between[widest]):.0f} degrees from point {widest + 1} to point "
            f"{widest + 2}; between two points at most 90: put points between them"
        )
    return CubicSpline(along, CubicSpline(chord, unit)(fine))
