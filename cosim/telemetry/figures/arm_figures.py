"""Figures of the arm: extremes of its joints, saturated servos, contacts of links."""

from dataclasses import dataclass, field
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.plan import arm_limits
from cosim.telemetry.tick_batch import TickBatch

_SATURATED: Final = 1.0 - 1e-9
"""Torque of a joint over its limit, above which its servo is saturated."""


@final
@dataclass(frozen=True)
class LastRow:
    """The last row, with which the next one is compared.

    Args:
        time_s: simulated time.
        position: (joints,) [rad].
        velocity: (joints,) [rad/s].
    """

    time_s: float
    position: Annotated[Array, ("joints",)]
    velocity: Annotated[Array, ("joints",)]


@final
@dataclass(frozen=True)
class ArmFigures:
    """Figures of the arm over the ticks so far.

    Args:
        extremes: by quantity.
        saturated_s: (joints,), time that each servo was at its torque limit; (0,) before the first tick.
        touches: of links.
        last: last row.
    """

    extremes: dict[str, arm_limits.Extreme] = field(default_factory=dict)
    saturated_s: Annotated[Array, ("*",)] = field(default_factory=lambda: np.zeros(0))
    touches: tuple[arm_limits.Touch, ...] = ()
    last: LastRow | None = None

    def after(self, batch: TickBatch, limits: arm_limits.ArmLimits, *, dynamic: bool) -> "ArmFigures":
        """Return the figures after further ticks.

        The joints at the start of a tick are compared with its reference, as servos act on this error.

        Args:
            batch: the ticks.
            limits: of the arm.
            dynamic: whether the run is dynamic.
        """
        time_s, q, v, torque = batch.time_s, batch.joint_position, batch.joint_velocity, batch.joint_torque
        last = self.last or LastRow(float(time_s[0]), q[0], v[0])
        values = {"position": q, "torque": torque, "tracking_error": q - batch.joint_target}
        span_s = np.diff(time_s, prepend=last.time_s)
        if dynamic:
            values["velocity"] = v
            length_s = np.where(span_s > 0.0, span_s, np.inf)[:, None]
            values["acceleration"] = np.diff(v, axis=0, prepend=last.velocity[None]) / length_s
            values["tracking_error"] = np.concatenate([last.position[None], q[:-1]]) - batch.joint_target
        extremes = dict(self.extremes)
        for name, rows in values.items():
            extreme = limits.extreme(name, rows, time_s, batch.phase, extremes.get(name))
            if extreme is not None:
                extremes[name] = extreme
        saturated_s = np.zeros(len(limits.joint_names))
        if "torque" in extremes and extremes["torque"].excess >= _SATURATED - 1.0:
            saturated_s = span_s @ (np.abs(torque) >= _SATURATED * limits.torque)
        touches = self.touches
        for row, contacts in batch.link_contacts.items():
            touches = arm_limits.with_touches(touches, contacts, float(time_s[row]), int(batch.phase[row]))
        return ArmFigures(
            extremes, saturated_s + (self.saturated_s if len(self.saturated_s) else 0.0), touches,
            LastRow(float(time_s[-1]), q[-1].copy(), v[-1].copy()),
        )  # fmt: skip

    def figures(self, limits: arm_limits.ArmLimits, phase_names: tuple[str, ...]) -> dict[str, Any]:
        """Return the figures for the summary."""
        extremes = {name: extreme.figures(phase_names) for name, extreme in self.extremes.items()}
        return {
            **{name: extremes.get(name) for name in arm_limits.UNITS},
            "saturated_s": dict(zip(limits.joint_names, self.saturated_s.tolist(), strict=False)),
            "contacts": [touch.figures(phase_names) for touch in self.touches],
        }

    def warnings(self, limits: arm_limits.ArmLimits, phase_names: tuple[str, ...]) -> list[str]:
        """Return a line for each quantity beyond its bound and for each contact, the worst first."""
        error = self.extremes.get("tracking_error")
        beyond = [extreme for extreme in self.extremes.values() if extreme.beyond and extreme is not error]
        lines = [extreme.text(phase_names) for extreme in beyond]
        full = np.flatnonzero(self.saturated_s)
        names, most = limits.joint_names, limits.torque
        units = np.where(limits.prismatic, "N", "N m")
        saturated = ", ".join(
            f"{names[k]} was at its limit of {most[k]:g} {units[k]} for {self.saturated_s[k]:.3f} s"
            for k in full
        )
        if error is not None and error.beyond:
            cause = (
                f"the arm did not hold: {saturated}; " if saturated else "the arm did not follow its plan: "
            )
            lines.insert(0, cause + error.text(phase_names))
        elif saturated:
            lines.insert(0, saturated)
        return lines + [touch.text(phase_names) for touch in self.touches]
