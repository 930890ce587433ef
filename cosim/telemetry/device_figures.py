"""Figures of the devices of a phase, gathered tick by tick; `docs/summary.md` documents every key."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.telemetry.tick_batch import TickBatch

SETTLED_SHARE: Final = 0.05
"""Of the step from the first value to the setpoint, within which a controlled quantity counts as settled."""


@final
@dataclass(frozen=True)
class DeviceFiguresState:
    """The figures of a phase so far.

    Args:
        last: report seen.
        time_s: of the ticks of the phase.
        measured: by each controller, by its name.
        setpoint: of each controller.
    """

    last: ActuationReport | None
    time_s: tuple[float, ...]
    measured: dict[str, tuple[float, ...]]
    setpoint: dict[str, float]


@final
class DeviceFigures:
    """Follows the devices through a run.

    Args:
        names: of the devices.
    """

    def __init__(self, names: DeviceNames) -> None:
        self._names = names
        self._last: ActuationReport | None = None
        self._begin()

    def observe(self, batch: TickBatch) -> None:
        """Take in ticks; they come in order."""
        self._last = batch.devices[-1]
        self._time_s += batch.time_s.tolist()
        for report in batch.devices:
            for control in () if report is None else report.controls:
                if control.measured is not None and control.setpoint is not None:
                    self._setpoint[control.name] = control.setpoint
                    self._measured.setdefault(control.name, []).append(control.measured)

    def close_phase(self) -> dict[str, Any]:
        """Return the figures of the phase that ends, and begin the next one."""
        devices = self._last
        if devices is None:
            return {}
        figures: dict[str, Any] = {
            "cable_length_m": devices.cable_length_m,
            "cable_unstretched_m": devices.unstretched_m,
            "bending_angle_rad": devices.bending_angle_rad,
        }
        if self._names.winches:
            figures["lost_steps"] = devices.lost_steps
        if devices.pumps:
            pairs = zip(self._names.pumps, devices.pumps, strict=True)
            figures["pumps"] = {name: asdict(pump) for name, pump in pairs}
        if self._measured:
            figures["controllers"] = {name: self._controlled(name) for name in self._measured}
        self._begin()
        return figures

    def _begin(self) -> None:
        self._time_s: list[float] = []
        self._measured: dict[str, list[float]] = {}
        self._setpoint: dict[str, float] = {}

    def save_state(self) -> DeviceFiguresState:
        """Return what was gathered since the phase began."""
        measured = {name: tuple(values) for name, values in self._measured.items()}
        return DeviceFiguresState(self._last, tuple(self._time_s), measured, dict(self._setpoint))

    def restore_state(self, state: DeviceFiguresState) -> None:
        """Go on from what was gathered."""
        self._last, self._time_s = state.last, list(state.time_s)
        self._measured = {name: list(values) for name, values in state.measured.items()}
        self._setpoint = dict(state.setpoint)

    def _controlled(self, name: str) -> dict[str, Any]:
        measured = np.array(self._measured[name])
        time_s = np.array(self._time_s)[-len(measured) :]
        return control_figures(time_s, measured, self._setpoint[name])


def control_figures(time_s: Array, measured: Array, setpoint: float) -> dict[str, Any]:
    """Return how well a quantity was brought to its setpoint.

    Args:
        time_s: (samples,), the first one right after the phase began.
        measured: (samples,), in the unit of the setpoint.
        setpoint: constant.

    Returns:
        setpoint; measured, the last value; overshoot, how far beyond the setpoint it went, seen from the
        first value; settling_time_s, after which it stayed within a twentieth of the step, None where that is
        not before the last tenth of the time; ripple, half the range in the last third of the time.
    """
    step = setpoint - float(measured[0])
    beyond = float(np.max((measured - setpoint) * np.sign(step)))
    outside = np.flatnonzero(np.abs(measured - setpoint) > SETTLED_SHARE * abs(step))
    last = int(outside[-1]) if len(outside) else 0
    settled = None if last >= 0.9 * len(measured) else float(time_s[last] - time_s[0])
    end = measured[2 * len(measured) // 3 :]
    return {
        "setpoint": setpoint,
        "measured": float(measured[-1]),
        "overshoot": max(beyond, 0.0),
        "settling_time_s": settled,
        "ripple": 0.5 * float(np.ptp(end)),
    }
