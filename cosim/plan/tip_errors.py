"""Paths of the tip in a plan and in a run, and the errors of the tip along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.base.tip_course import CourseInstant, TipCourse


@final
@dataclass(frozen=True)
class TipErrors:
    """Errors of a tip along its path.

    Args:
        largest_m: largest distance from the target.
        mean_m: mean distance.
        at_m: length along the path at the largest distance.
        largest_rad: largest angle from the target's direction; 0 if the direction is free.
    """

    largest_m: float
    mean_m: float
    at_m: float
    largest_rad: float

    @classmethod
    def of(cls, wanted: CourseInstant, position: Array, direction: Array) -> TipErrors:
        """Return the errors of n tips.

        Args:
            wanted: targets at n instants.
            position: (n, 3) [m], of the tips, world.
            direction: (n, 3), of the tips, world.
        """
        distance, angle = tip_distances(wanted, position, direction)
        k = int(np.argmax(distance))
        return cls(float(distance[k]), float(distance.mean()), float(wanted.along_m[k]), float(angle.max()))

    def figures(self) -> dict[str, float]:
        """Return the errors for the summary."""
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
    """A path of the tip, planned on the statics with gravity less the path's acceleration.

    Args:
        course: target of the tip over time.
        compensated: remaining errors of the plan.
        uncompensated: errors with the flange at the pose at which a straight arm would be on the path; None
            if the arm has no equilibria along the whole path.
    """

    course: TipCourse
    compensated: TipErrors
    uncompensated: TipErrors | None


@final
@dataclass(frozen=True)
class TipPathInfo:
    """A tip path in a run.

    Args:
        planned: the path.
        begin_s: simulated time.
        lasts_s: simulated time from its begin to its end.
    """

    planned: PlannedTipPath
    begin_s: float
    lasts_s: float

    def at(self, time_s: Array) -> CourseInstant:
        """Return the tip's target at instants (n,) [s] of the run."""
        course = self.planned.course
        return course.at((time_s - self.begin_s) / self.lasts_s * course.duration_s)

    def passes(self, time_s: Array) -> Mask:
        """Return a mask (n,) of the instants (n,) [s] of the phase at which the path has not ended."""
        return np.asarray(time_s <= self.begin_s + self.lasts_s * (1.0 + 1e-9))
