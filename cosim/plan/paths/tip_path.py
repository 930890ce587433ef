"""Paths of the tip, as they have been planned and as they are passed in a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.base.tip_course import CourseInstant, TipCourse


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
