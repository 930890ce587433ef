"""A motion of the flange through poses that have been worked out one by one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.frames import Array, Pose, rotation_from_quaternion
from cosim.base.tip_course import CourseInstant, TipCourse

_KNOT_s: Final = 0.02  # of the joints' spline
_PER_RAMP: Final = 10
_FEWEST, _MOST = 50, 2000  # of its knots


@final
class PoseTrack:
    """A motion from rest to rest: cubic splines through the flange's places and quaternions over time.

    Args:
        time_s: (k,), from 0 on, increasing.
        poses: k, world from flange.
        course: of the tip, that it is made for.
    """

    even: Final = False

    def __init__(self, time_s: Array, poses: Sequence[Pose], course: TipCourse) -> None:
        rows = np.array([[*pose.translation, *pose.quaternion] for pose in poses])
        for k in range(1, len(rows)):  # a quaternion and its opposite are one rotation
            if rows[k, 3:] @ rows[k - 1, 3:] < 0.0:
                rows[k, 3:] *= -1.0
        self._end_s = float(time_s[-1])
        self._spline = CubicSpline(time_s, rows, bc_type="clamped")
        self.begin, self.end, self.course = poses[0], poses[-1], course

    def at(self, fraction: float) -> Pose:
        """Return world_from_flange at a fraction of the time."""
        row = self._spline(fraction * self._end_s)
        return Pose(rotation_from_quaternion(row[3:] / np.linalg.norm(row[3:])), row[:3])

    @property
    def pieces(self) -> int:
        """Into how many small motions it is cut."""
        return min(max(_FEWEST, math.ceil(self._end_s / min(_KNOT_s, self.course.ramp_s / _PER_RAMP))), _MOST)

    def instant(self, fraction: float) -> CourseInstant:
        """Return where the tip is to be at a fraction of the time."""
        return self.course.at(fraction * self.course.duration_s)
