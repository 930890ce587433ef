"""The curves of a recording: what is plotted, in which unit, under which name.

One plot of a recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.recording.colours import (
    GREEN,
    GREY,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    WHITE,
    Colour,
    series_colours,
)
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch


@dataclass(frozen=True)
class Plot:
    """One plot with its curves.

    Args:
        entity: path under `/plots`; one below another plot's path joins that plot.
        title: with the unit; empty if the curves join another plot.
        tab: the tab it is shown in.
        series: name of each curve.
        colours: of each curve.
        values: the curves' values in a batch of k ticks, (k, series) or for one curve (k,), in the
            title's unit; not a number: no point.
        legend: whether the plot names its curves.
        peaks: whether crowded curves show their largest value rather than their range.
    """

    entity: str
    title: str
    tab: str
    series: tuple[str, ...]
    colours: Sequence[Colour]
    values: Callable[[TickBatch], Array]
    legend: bool = True
    peaks: bool = False


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


SMALLEST_RESIDUAL_N = 1e-16
"""Shown for an exact zero, which has no logarithm."""

_OF_AN_ARM = frozenset({"power_error", "stability", "joint_error"})


def plots_of(stage: RunInfo, joints: int) -> tuple[Plot, ...]:
    """Return the plots of a run, in the order in which they are shown.

    Args:
        stage: what is run.
        joints: of the arm; 0 without one.
    """
    plots = (*_robot_plots(stage), *device_plots(stage), *_interface_plots(), *_run_plots(stage, joints))
    return plots if joints else tuple(plot for plot in plots if plot.entity not in _OF_AN_ARM)


def _robot_plots(stage: RunInfo) -> list[Plot]:
    cables = len(stage.cables)
    plots = [
        *_gas_plots(stage.chamber_names),
        Plot(
            "tip_position",
            "Tip position, world [mm]",
            "Robot",
            ("x", "y", "z"),
            [VERMILION, GREEN, SKY],
            lambda b: 1e3 * b.tip_position,
        ),
    ]
    if cables:
        names = stage.cable_names or tuple(f"cable {k + 1}" for k in range(cables))
        tension = Plot(
            "tension",
            "Cable tension [N]",
            "Robot",
            names,
            series_colours(cables),
            lambda b: b.cable_tension_N,
        )
        plots.insert(2, tension)
    plots += [
        Plot("sag", "Sag [mm]", "Robot", ("sag",), [ORANGE], lambda b: 1e3 * b.sag_m),
        Plot("sag/target", "", "Robot", ("tip to target",), [GREEN], lambda b: 1e3 * target_distance(b)),
    ]
    return plots


def _gas_plots(chambers: tuple[str, ...]) -> list[Plot]:
    several = len(chambers) > 1
    return [
        Plot(
            "pressure",
            "Pressure [kPa]",
            "Robot",
            chambers if several else ("gauge pressure",),
            series_colours(len(chambers)) if several else [SKY],
            lambda b: 1e-3 * b.chamber_pressure_Pa,
            legend=several,
        ),
        Plot(
            "volume",
            "Chamber volume [ml]",
            "Robot",
            chambers if several else ("volume",),
            series_colours(len(chambers)) if several else [GREEN],
            lambda b: 1e6 * b.chamber_volume_m3,
            legend=several,
        ),
    ]


def _interface_plots() -> list[Plot]:
    return [
        Plot(
            "flange_force",
            "Force on the flange, world [N]",
            "Interface",
            ("x", "y", "z"),
            [VERMILION, GREEN, SKY],
            lambda b: b.flange_force,
        ),
        Plot(
            "flange_torque",
            "Torque on the flange, world [N m]",
            "Interface",
            ("x", "y", "z"),
            [VERMILION, GREEN, SKY],
            lambda b: b.flange_torque,
        ),
        Plot(
            "power_error",
            "Power lost at the interface [W]",
            "Interface",
            ("power error",),
            [PINK],
            lambda b: b.power_error_W,
            legend=False,
        ),
        Plot(
            "stability",
            "Stability ratio of the coupling",
            "Interface",
            ("mass ratio",),
            [ORANGE],
            lambda b: b.stability_ratio,
            legend=False,
        ),
    ]


def _run_plots(stage: RunInfo, joints: int) -> list[Plot]:
    real_time = stage.mode == "dynamic"
    cost = Plot(
        "tick_cost",
        "Cost of a tick [ms]",
        "Run",
        ("wall time", "tick length") if real_time else ("wall time",),
        [ORANGE, GREY],
        lambda b: cost_ms(b, stage.tick_s if real_time else None),
        peaks=True,
    )
    tracking = Plot(
        "joint_error",
        "Joint error [mrad]",
        "Run",
        tuple(f"joint {k + 1}" for k in range(joints)),
        series_colours(joints),
        lambda b: 1e3 * (b.joint_position - b.joint_target),
    )
    return [*_solver_plots(), cost, tracking]


def _solver_plots() -> list[Plot]:
    return [
        Plot(
            "residual",
            "Out-of-balance force [log10 N]",
            "Run",
            ("residual",),
            [SKY],
            lambda b: np.log10(np.maximum(b.residual_N, SMALLEST_RESIDUAL_N)),
            legend=False,
            peaks=True,
        ),
        Plot(
            "newton",
            "Newton iterations per tick",
            "Run",
            ("iterations",),
            [WHITE],
            lambda b: b.newton_iterations.astype(np.float64),
            legend=False,
            peaks=True,
        ),
    ]


def cost_ms(batch: TickBatch, tick_s: float | None) -> Array:
    """Return the wall time of ticks [ms]; (k, 2) with the length of a tick if that is given, else (k,)."""
    wall = 1e3 * batch.tick_wall_s
    return wall if tick_s is None else np.stack([wall, np.full(len(batch), 1e3 * tick_s)], axis=1)


def target_distance(batch: TickBatch) -> Array:
    """Return the distance of the tip from its target (k,) [m]; not a number while there is none.

    A component of the target that is not a number is free and does not count.
    """
    away = batch.tip_position - batch.tip_target
    away[np.isnan(away)] = 0.0
    return np.where(batch.has_tip_target, np.sqrt((away * away).sum(axis=1)), np.nan)
