"""How near a tip came to the path that a phase asks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.plan.paths.tip_path import TipErrors, TipPathInfo, tip_distances
from cosim.telemetry.tick_batch import TickBatch


@final
@dataclass(frozen=True)
class TipPathFigures:
    """Errors of the ticks of one phase so far, as the path is passed.

    Args:
        ticks: seen.
        sum_m: of their distances.
        largest_m: distance.
        at_m: of path, there.
        largest_rad: angle.
    """

    ticks: int = 0
    sum_m: float = 0.0
    largest_m: float = 0.0
    at_m: float = 0.0
    largest_rad: float = 0.0

    def after(self, batch: TickBatch, path: TipPathInfo) -> TipPathFigures:
        """Return the figures with some ticks more, all of the path's phase."""
        rows = np.flatnonzero(path.passes(batch.time_s))
        if not len(rows):
            return self
        wanted = path.at(batch.time_s[rows])
        away, turned = tip_distances(wanted, batch.tip_position[rows], batch.tip_direction[rows])
        place = int(np.argmax(away))
        farther = not away[place] <= self.largest_m  # what is not a number is told as well
        return TipPathFigures(
            self.ticks + len(rows),
            self.sum_m + float(away.sum()),
            float(away[place]) if farther else self.largest_m,
            float(wanted.along_m[place]) if farther else self.at_m,
            max(self.largest_rad, float(turned.max())),
        )

    def figures(self, path: TipPathInfo) -> dict[str, Any]:
        """Return them for the summary, beside what was planned."""
        planned = path.planned
        mean_m = self.sum_m / self.ticks if self.ticks else 0.0
        found = TipErrors(self.largest_m, mean_m, self.at_m, self.largest_rad)
        return {
            "length_m": planned.course.length_m,
            "speed_m_s": planned.course.speed_m_s,
            **found.figures(),
            "planned": planned.compensated.figures(),
            "uncompensated": planned.uncompensated and planned.uncompensated.figures(),
        }


def path_lines(phases: list[dict[str, Any]]) -> list[str]:
    """Return the Markdown lines on the phases that follow a path; none without one."""
    rows = [(phase["name"], phase["tip_path"]) for phase in phases if "tip_path" in phase]
    if not rows:
        return []
    head = "| tip path | length [mm] | speed [mm/s] | of | largest error [mm] | mean [mm] | angle [deg] |"
    lines = ["", head, "|---|---|---|---|---|---|---|"]
    for name, path in rows:
        for of, found in (
            ("run", path),
            ("planned", path["planned"]),
            ("uncompensated", path["uncompensated"]),
        ):
            lines.append("| " + " | ".join((*_begin(name, path), of, *_cells(found))) + " |")
    return lines


def _begin(name: str, path: dict[str, Any]) -> tuple[str, str, str]:
    return name, f"{1e3 * path['length_m']:.1f}", f"{1e3 * path['speed_m_s']:g}"


def _cells(found: dict[str, Any] | None) -> tuple[str, ...]:
    if found is None:
        return ("no equilibria", "", "")
    scaled = (
        (found["largest_error_m"], 1e3),
        (found["mean_error_m"], 1e3),
        (found["largest_angle_rad"], 180.0 / np.pi),
    )
    return tuple("?" if value is None else f"{scale * value:.3f}" for value, scale in scaled)
