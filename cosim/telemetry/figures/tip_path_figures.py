"""Errors of the tip on a path."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.plan import tip_errors
from cosim.telemetry.tick_batch import TickBatch


@final
@dataclass(frozen=True)
class TipPathFigures:
    """Errors of the tip on the path of a phase, over the ticks so far.

    Args:
        ticks: number of ticks.
        sum_m: sum of the distances.
        largest_m: largest distance.
        at_m: length of path at that distance.
        largest_rad: largest angle.
    """

    ticks: int = 0
    sum_m: float = 0.0
    largest_m: float = 0.0
    at_m: float = 0.0
    largest_rad: float = 0.0

    def after(self, batch: TickBatch, path: tip_errors.TipPathInfo) -> "TipPathFigures":
        """Return the figures after further ticks, all of the path's phase."""
        rows = np.flatnonzero(path.passes(batch.time_s))
        if not len(rows):
            return self
        wanted = path.at(batch.time_s[rows])
        away, turned = tip_errors.tip_distances(wanted, batch.tip_position[rows], batch.tip_direction[rows])
        k = int(np.argmax(away))
        farther = not away[k] <= self.largest_m  # also if it is not a number
        return TipPathFigures(
            self.ticks + len(rows),
            self.sum_m + float(away.sum()),
            float(away[k]) if farther else self.largest_m,
            float(wanted.along_m[k]) if farther else self.at_m,
            max(self.largest_rad, float(turned.max())),
        )

    def figures(self, path: tip_errors.TipPathInfo) -> dict[str, Any]:
        """Return the figures for the summary, with those of the plan."""
        planned = path.planned
        mean_m = self.sum_m / self.ticks if self.ticks else 0.0
        errors = tip_errors.TipErrors(self.largest_m, mean_m, self.at_m, self.largest_rad)
        return {
            "length_m": planned.course.length_m,
            "speed_m_s": planned.course.speed_m_s,
            **errors.figures(),
            "planned": planned.compensated.figures(),
            "uncompensated": planned.uncompensated and planned.uncompensated.figures(),
        }
