"""Figures of pumps, winches and controllers."""

from dataclasses import asdict, dataclass, field
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.telemetry.tick_batch import TickBatch

SETTLED: Final = 0.05
"""Distance from the setpoint of a settled quantity, over the step from its first value."""


@final
@dataclass(frozen=True)
class DeviceFigures:
    """Devices over the ticks of a phase so far.

    Args:
        last: last report.
        time_s: of the ticks.
        measured: values of each controller, by its name.
        setpoint: of each controller.
    """

    last: ActuationReport | None = None
    time_s: tuple[float, ...] = ()
    measured: dict[str, tuple[float, ...]] = field(default_factory=dict)
    setpoint: dict[str, float] = field(default_factory=dict)

    def after(self, batch: TickBatch) -> "DeviceFigures":
        """Return the figures after further ticks."""
        measured = {name: list(values) for name, values in self.measured.items()}
        setpoint = dict(self.setpoint)
        for report in batch.devices:
            for control in () if report is None else report.controls:
                if control.measured is not None and control.setpoint is not None:
                    setpoint[control.name] = control.setpoint
                    measured.setdefault(control.name, []).append(control.measured)
        frozen = {name: tuple(values) for name, values in measured.items()}
        return DeviceFigures(batch.devices[-1], (*self.time_s, *batch.time_s.tolist()), frozen, setpoint)

    def figures(self, names: DeviceNames) -> dict[str, Any]:
        """Return the figures for the summary, at the end of a phase."""
        devices = self.last
        if devices is None:
            return {}
        figures: dict[str, Any] = {
            "cable_length_m": devices.cable_length_m,
            "cable_unstretched_m": devices.unstretched_m,
            "cable_off_drum_m": devices.off_drum_m,
            "bending_angle_rad": devices.bending_angle_rad,
        }
        if names.winches:
            figures["lost_steps"] = devices.lost_steps
        if devices.pumps:
            figures["pumps"] = dict(zip(names.pumps, map(asdict, devices.pumps), strict=True))
        if self.measured:
            time_s = np.array(self.time_s)
            figures["controllers"] = {
                name: control_figures(time_s[-len(values) :], np.array(values), self.setpoint[name])
                for name, values in self.measured.items()
            }
        return figures


def control_figures(time_s: Array, measured: Array, setpoint: float) -> dict[str, Any]:
    """Return figures of a controlled quantity.

    Args:
        time_s: (samples,), the first one right after the phase began.
        measured: (samples,), in the unit of the setpoint.
        setpoint: constant.

    Returns:
        setpoint; measured, the last value; overshoot, the largest distance beyond the setpoint, seen from the
        first value; settling_time_s, after which it stayed within a twentieth of the step, None if that is
        within the last tenth of the time; ripple, half the range in the last third of the time.
    """
    step = setpoint - float(measured[0])
    beyond = float(np.max((measured - setpoint) * np.sign(step)))
    outside = np.flatnonzero(np.abs(measured - setpoint) > SETTLED * abs(step))
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
