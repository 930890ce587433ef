"""Contacts of the soft robot with bodies: impulse, duration, force, and hits that steps do not resolve."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.telemetry.tick_batch import TickBatch


@final
@dataclass(frozen=True)
class TouchedFigures:
    """Contacts of the soft robot with bodies so far, in time.

    Args:
        impulse: (bodies, 3) [N s], world axes.
        ticks: (bodies,), number of ticks with contact.
        force: (bodies,) [N], largest mean force of a tick.
        hits: (bodies, 3), least resolved contact of each body: speed [m/s], way of the body in a step that
            would resolve it [m], and length of the step [s].
    """

    impulse: Annotated[Array, ("bodies", 3)]
    ticks: Annotated[Array, ("bodies",)]
    force: Annotated[Array, ("bodies",)]
    hits: Annotated[Array, ("bodies", 3)]

    @classmethod
    def none(cls, bodies: int) -> "TouchedFigures":
        """Return the figures before the first tick."""
        return cls(np.zeros((bodies, 3)), np.zeros(bodies), np.zeros(bodies), np.zeros((bodies, 3)))

    def after(self, batch: TickBatch, tick_s: float) -> "TouchedFigures":
        """Return the figures after further ticks, each of a length [s]."""
        force, hits = batch.body_contact_force, self.hits.copy()
        size = np.sqrt((force * force).sum(axis=2))
        for row in np.flatnonzero(batch.hit_body >= 0).tolist():
            substeps, body = batch.substeps.get(row), batch.hit_body[row]
            step_s = tick_s if substeps is None else tick_s / len(substeps.positions)
            hit = np.array([batch.hit_m_s[row], batch.hit_way_m[row], step_s])
            if _steps_missing(hit) > _steps_missing(hits[body]):
                hits[body] = hit
        return TouchedFigures(
            self.impulse + tick_s * force.sum(axis=0),
            self.ticks + (size > 0.0).sum(axis=0),
            np.fmax(self.force, size.max(axis=0, initial=0.0)),
            hits,
        )

    def figures(self, names: tuple[str, ...], tick_s: float) -> list[dict[str, Any]]:
        """Return the figures of each touched body for the summary."""
        rows = []
        for k in np.flatnonzero(self.ticks).tolist():
            duration_s = tick_s * float(self.ticks[k])
            rows.append(
                {
                    "body": names[k],
                    "impulse_Ns": self.impulse[k],
                    "duration_s": duration_s,
                    "mean_force_N": float(np.linalg.norm(self.impulse[k])) / duration_s,
                    "max_force_N": float(self.force[k]),
                    "max_over_s": tick_s,
                    "hit": _unresolved(self.hits[k]),
                }
            )
        return rows


def _steps_missing(hit: Array) -> float:
    """Return the number of steps instead of one that would resolve a hit; 0 without a hit."""
    speed, way, step_s = hit
    return float(speed * step_s / way) if way > 0.0 else 0.0


def _unresolved(hit: Array) -> dict[str, float] | None:
    """Return a hit that its step does not resolve, for the summary; None for a resolved one."""
    if _steps_missing(hit) <= 1.0:
        return None
    speed, way, step_s = hit.tolist()
    # two digits, and a little less: in shorter ticks the hit is faster
    resolving_s = float(f"{0.9 * way / speed:.1e}")
    return {"speed_m_s": speed, "way_m": speed * step_s, "resolving_tick_s": resolving_s}


def touched_lines(touched: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on each body that the soft robot has touched."""
    lines = []
    for row in touched:
        impulse = float(np.linalg.norm(row["impulse_Ns"]))
        lines.append(
            f"'{row['body']}' received {impulse:.3g} N s in {row['duration_s']:.3g} s of contact, mean force "
            f"{row['mean_force_N']:.3g} N; at most {row['max_force_N']:.3g} N over one tick of "
            f"{1e3 * row['max_over_s']:g} ms"
        )
    return lines


def hit_warnings(touched: Sequence[dict[str, Any]]) -> list[str]:
    """Return a warning for each body whose hit is not resolved."""
    return [
        f"the hit of '{row['body']}' is not resolved: at {hit['speed_m_s']:.2g} m/s it passes "
        f"{1e3 * hit['way_m']:.2g} mm in a step, so the largest force and the rebound depend on the tick; "
        f"set clock.tick_s = {hit['resolving_tick_s']:g}, or use impulse_Ns in the summary"
        for row in touched
        if (hit := row["hit"]) is not None
    ]
