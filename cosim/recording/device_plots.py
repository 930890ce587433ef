"""The curves of pumps, winches and controllers; only those that a scenario has."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.recording.colours import GREEN, ORANGE, SKY, Colour, series_colours
from cosim.recording.plot import Plot
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch

_TAB: Final = "Devices"
_SHOWN: Final[dict[str, tuple[str, float]]] = {
    "bending_angle_rad": ("Bending angle [deg]", math.degrees(1.0)),
    "tip_height_m": ("Tip height [mm]", 1e3),
}
"""What controllers measure: title and scale."""


def device_plots(stage: RunInfo) -> list[Plot]:
    """Return the plots of a scenario's devices; none where it has none."""
    names = stage.devices
    if names is None:
        return []
    return [*_control_plots(names), *_cable_plots(stage, names), *_pump_plots(names)]


def _plot(
    entity: str,
    title: str,
    series: tuple[str, ...],
    values: Callable[[ActuationReport], Array | tuple[float, ...]],
    colours: Sequence[Colour] | None = None,
) -> Plot:
    def of(batch: TickBatch) -> Array:
        return np.array([values(report) for report in _reports(batch)])

    shown = series_colours(len(series)) if colours is None else colours
    return Plot(entity, title, _TAB, series, shown, of)


def _reports(batch: TickBatch) -> list[ActuationReport]:
    """Return what each tick of a scenario with devices says on them."""
    return [report for report in batch.devices if report is not None]


def _control_plots(names: DeviceNames) -> list[Plot]:
    measured = {quantity for _, quantity in names.controllers}
    plots: list[Plot] = []
    for quantity, (title, scale) in _SHOWN.items():
        if quantity in measured:
            own = {name for name, measures in names.controllers if measures == quantity}
            plots += _control_plot(quantity, title, scale, own)
    return plots


def _control_plot(quantity: str, title: str, scale: float, own: set[str]) -> tuple[Plot, Plot]:
    def measured(batch: TickBatch) -> Array:
        if quantity == "tip_height_m":
            return scale * batch.tip_position[:, 2]
        return np.array([scale * report.bending_angle_rad for report in _reports(batch)])

    def setpoint(batch: TickBatch) -> Array:
        return np.array([scale * _setpoint(report, own) for report in _reports(batch)])

    entity = f"control/{quantity}"
    return (
        Plot(entity, title, _TAB, ("measured",), [SKY], measured),
        Plot(f"{entity}/setpoint", "", _TAB, ("setpoint",), [ORANGE], setpoint),
    )


def _setpoint(devices: ActuationReport, own: set[str]) -> float:
    """Return the setpoint of the first of some controllers that acts; not a number if none does."""
    given = [c.setpoint for c in devices.controls if c.name in own and c.setpoint is not None]
    return given[0] if given else math.nan


def _cable_plots(stage: RunInfo, names: DeviceNames) -> list[Plot]:
    if not names.lengths:
        return []
    cables = stage.cable_names
    plots = [
        _plot("cable_length", "Cable route [mm]", cables, lambda d: 1e3 * d.cable_length_m),
        _plot("cable_unstretched", "Cable off the drum [mm]", cables, lambda d: 1e3 * _off_the_drum(d)),
    ]
    if names.winches:
        plots.append(_plot("lost_steps", "Lost steps", cables, lambda d: d.lost_steps.astype(float)))
    return plots


def _off_the_drum(devices: ActuationReport) -> Array:
    """Return the unstretched length of each cable (cables,) [m]; of one under a given tension its route."""
    return np.where(np.isnan(devices.unstretched_m), devices.cable_length_m, devices.unstretched_m)


def _pump_plots(names: DeviceNames) -> list[Plot]:
    if not names.pumps:
        return []
    on = ("running", "venting") if len(names.pumps) == 1 else names.pumps

    def running(devices: ActuationReport) -> tuple[float, ...]:
        if len(devices.pumps) == 1:
            return float(devices.pumps[0].on), float(devices.pumps[0].venting)
        return tuple(float(pump.on) for pump in devices.pumps)

    def delivered(devices: ActuationReport) -> tuple[float, ...]:
        return tuple(1e6 * pump.delivered_kg for pump in devices.pumps)

    colours = [GREEN, ORANGE] if len(on) == 2 else None
    return [
        _plot("pump", "Pump on [1]", on, running, colours),
        _plot("gas_delivered", "Gas delivered [mg]", names.pumps, delivered),
    ]
