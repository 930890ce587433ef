"""How an arm fared in a run: joints against their bounds and references, links against what they touch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.plan.arm_limits import UNITS, ArmLimits, Extreme, Touch, with_touches
from cosim.telemetry.tick_batch import TickBatch

_SATURATED: Final = 1.0 - 1e-9
"""Share of a joint's torque above which its servo has no more to give."""


@final
@dataclass(frozen=True)
class LastRow:
    """What the next row is compared with.

    Args:
        time_s: simulated.
        position: (joints,) [rad].
        velocity: (joints,) [rad/s].
    """

    time_s: float
    position: Annotated[Array, ("joints",)]
    velocity: Annotated[Array, ("joints",)]


@final
@dataclass(frozen=True)
class ArmFigures:
    """Figures of the ticks so far.

    Args:
        extremes: by quantity.
        saturated_s: (joints,), how long each servo gave all it can; (0,) before the first tick.
        touches: of links.
        last: row seen.
    """

    extremes: dict[str, Extreme] = field(default_factory=dict)
    saturated_s: Annotated[Array, ("*",)] = field(default_factory=lambda: np.zeros(0))
    touches: tuple[Touch, ...] = ()
    last: LastRow | None = None

    def after(self, batch: TickBatch, limits: ArmLimits, *, dynamic: bool) -> ArmFigures:
        """Return the figures with some ticks more.

        The servos act on the error at the start of a tick: there the reference is compared with the joints.

        Args:
            batch: the ticks.
            limits: of the arm.
            dynamic: whether the mode is.
        """
        time_s, q, v, torque = batch.time_s, batch.joint_position, batch.joint_velocity, batch.joint_torque
        last = self.last or LastRow(float(time_s[0]), q[0], v[0])
        values = {"position": q, "torque": torque, "tracking_error": q - batch.joint_target}
        span_s = np.diff(time_s, prepend=last.time_s)
        if dynamic:
            values["velocity"] = v
            gone = np.where(span_s > 0.0, span_s, np.inf)[:, None]
            values["acceleration"] = np.diff(v, axis=0, prepend=last.velocity[None]) / gone
            values["tracking_error"] = np.concatenate([last.position[None], q[:-1]]) - batch.joint_target
        extremes = dict(self.extremes)
        for name, rows in values.items():
            found = limits.extreme(name, rows, time_s, batch.phase, extremes.get(name))
            if found is not None:
                extremes[name] = found
        saturated_s = np.zeros(len(limits.joint_names))
        if "torque" in extremes and extremes["torque"].excess >= _SATURATED - 1.0:
            saturated_s = span_s @ (np.abs(torque) >= _SATURATED * limits.torque)
        touches = self.touches
        for row, contacts in batch.link_contacts.items():
            touches = with_touches(touches, contacts, float(time_s[row]), int(batch.phase[row]))
        return ArmFigures(
            extremes, saturated_s + (self.saturated_s if len(self.saturated_s) else 0.0), touches,
            LastRow(float(time_s[-1]), q[-1].copy(), v[-1].copy()),
        )  # fmt: skip

    def figures(self, limits: ArmLimits, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return them for the summary."""
        found = {name: extreme.figures(phase_names) for name, extreme in self.extremes.items()}
        return {
            **{name: found.get(name) for name in UNITS},
            "saturated_s": dict(zip(limits.joint_names, self.saturated_s.tolist(), strict=False)),
            "contacts": [touch.figures(phase_names) for touch in self.touches],
        }

    def warnings(self, limits: ArmLimits, phase_names: tuple[str, ...]) -> list[str]:
        """Return one line for whatever went beyond its bound, and for each contact; what is worst first."""
        error = self.extremes.get("tracking_error")
        beyond = [extreme for extreme in self.extremes.values() if extreme.beyond and extreme is not error]
        lines = [extreme.text(phase_names) for extreme in beyond]
        full = np.flatnonzero(self.saturated_s)
        names, given = limits.joint_names, limits.torque
        units = np.where(limits.prismatic, "N", "N m")
        spent = ", ".join(
            f"{names[k]} gave all of its {given[k]:g} {units[k]} for {self.saturated_s[k]:.3f} s"
            for k in full
        )
        if error is not None and error.beyond:
            collapsed = f"the arm did not hold: {spent}; " if spent else "the arm did not follow its plan: "
            lines.insert(0, collapsed + error.text(phase_names))
        elif spent:
            lines.insert(0, spent)
        return lines + [touch.text(phase_names) for touch in self.touches]


def arm_table(arm: dict[str, Any] | None) -> list[str]:
    """Return the Markdown lines of a summary's section on the arm; none without one."""
    if arm is None:
        return []
    lines = ["", "| arm | of | joint | value | bound | at [s] | phase |", "|---|---|---|---|---|---|---|"]
    for of, found in arm.items():
        for name in UNITS:
            extreme = found.get(name)
            if extreme is None:
                continue
            value, bound = ("none" if x is None else f"{x:.4g}" for x in (extreme["value"], extreme["bound"]))
            cells = (
                f"{name.replace('_', ' ')} [{extreme['unit']}]", of, extreme["joint"], value, bound,
                f"{extreme['time_s']:.2f}", extreme["phase"],
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]
