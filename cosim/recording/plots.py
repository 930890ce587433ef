"""The curves of a recording: columns that have a view, devices, sensors, and the energy balance."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from cosim.base.column import Column, View, columns_of
from cosim.base.columns import TickColumns
from cosim.base.frames import Array
from cosim.base.names import BETWEEN, LOST, MADE, PUT_IN, TERMS
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.recording import colours
from cosim.recording.colours import GREEN, GREY, ORANGE, PINK, SKY, Colour, series_colours
from cosim.telemetry import run_info, tick_batch

_SHOWN: Final[dict[str, tuple[str, float]]] = {
    "bending_angle_rad": ("Bending angle [deg]", math.degrees(1.0)),
    "tip_height_m": ("Tip height [mm]", 1e3),
}
"""Quantities that controllers measure: title and scale."""
_PREFIXES: Final = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa"), "rad": (math.degrees(1.0), "deg")}
ERROR_BARS: Final = {
    "tip_m": ("tip_position", 1e3),
    "sag_m": ("sag", 1e3),
    "volume_m3": ("volume", 1e6),
    "cable_tension_N": ("tension", 1.0),
}
"""Plots with error bars and their scales, by the figure's key in a summary."""
SMALLEST_LOGARITHM: Final = 1e-16
"""Shown instead of an exact zero on a logarithmic axis."""
_OF_AN_ARM = frozenset({"power_error", "stability", "joint_error"})


@dataclass(frozen=True)
class Plot:
    """One plot with its curves.

    Args:
        entity: path under `/plots`; one below another plot's path joins that plot.
        title: with the unit; empty if the curves join another plot.
        series: name of each curve.
        values: function of a batch of k ticks that returns the curves' values (k, series), or (k,) for one
            curve, in the title's unit. NaN draws no point.
        colours: of each curve; empty for the default colours of a series.
        legend: whether the plot names its curves.
        peaks: whether the viewer shows the largest value of dense samples, not their range.
        tab: tab of the viewer that shows the plot.
    """

    entity: str
    title: str
    series: tuple[str, ...]
    values: Callable[[tick_batch.TickBatch], Array]
    colours: Sequence[Colour] = ()
    legend: bool = True
    peaks: bool = False
    tab: str = ""


def device_plots(stage: run_info.RunInfo) -> list[Plot]:
    """Return the plots of a scenario's devices."""
    names = stage.devices
    if names is None:
        return []
    return [*_control_plots(names), *_cable_plots(stage, names), *_pump_plots(names)]


def sensor_plots(stage: run_info.RunInfo) -> list[Plot]:
    """Return the plots of the sensors: readings and true values."""
    plots, begin = [], 0
    for sensor in stage.sensors:
        scale, unit = _PREFIXES.get(sensor.unit, (1.0, sensor.unit))
        rows = slice(begin, begin := begin + len(sensor.values))
        for of in ("reading", "truth"):
            series = tuple(" ".join(filter(None, (of, value))) for value in sensor.values)
            entity, title = f"sensors/{sensor.name}", f"Sensor {sensor.name} [{unit}]"
            if of == "truth":
                entity, title = f"{entity}/truth", ""
            plots.append(Plot(entity, title, series, partial(_sensed, f"sensor_{of}", rows, scale)))
    return plots


def _sensed(array: str, columns: slice, scale: float, batch: tick_batch.TickBatch) -> Array:
    return np.asarray(scale * getattr(batch, array)[:, columns])


def _plot(
    entity: str,
    title: str,
    series: tuple[str, ...],
    values: Callable[[ActuationReport], Array | tuple[float, ...]],
    colours: Sequence[Colour] = (),
) -> Plot:
    return Plot(entity, title, series, lambda batch: np.array(list(map(values, _reports(batch)))), colours)


def _reports(batch: tick_batch.TickBatch) -> list[ActuationReport]:
    """Return the report of the devices at each tick."""
    return [report for report in batch.devices if report is not None]


def _control_plots(names: DeviceNames) -> list[Plot]:
    measured = {quantity for _, quantity in names.controllers}
    plots: list[Plot] = []
    for quantity, (title, scale) in _SHOWN.items():
        if quantity in measured:
            controllers = {name for name, measures in names.controllers if measures == quantity}
            plots += _control_plot(quantity, title, scale, controllers)
    return plots


def _control_plot(quantity: str, title: str, scale: float, controllers: set[str]) -> tuple[Plot, Plot]:
    def measured(batch: tick_batch.TickBatch) -> Array:
        if quantity == "tip_height_m":
            return scale * batch.tip_position[:, 2]
        return np.array([scale * report.bending_angle_rad for report in _reports(batch)])

    def setpoint(batch: tick_batch.TickBatch) -> Array:
        return np.array([scale * _setpoint(report, controllers) for report in _reports(batch)])

    entity = f"control/{quantity}"
    return (
        Plot(entity, title, ("measured",), measured, [SKY]),
        Plot(f"{entity}/setpoint", "", ("setpoint",), setpoint, [ORANGE]),
    )


def _setpoint(devices: ActuationReport, controllers: set[str]) -> float:
    """Return the setpoint of the first of these controllers that is active; NaN if none is."""
    setpoints = [c.setpoint for c in devices.controls if c.name in controllers and c.setpoint is not None]
    return setpoints[0] if setpoints else math.nan


def _cable_plots(stage: run_info.RunInfo, names: DeviceNames) -> list[Plot]:
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
    """Return the unstretched length of each cable (cables,) [m]; its route if its tension is given."""
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

    two = [GREEN, ORANGE] if len(on) == 2 else ()
    return [
        _plot("pump", "Pump on [1]", on, running, two),
        _plot("gas_delivered", "Gas delivered [mg]", names.pumps, delivered),
    ]


def plots_of(stage: run_info.RunInfo, joints: int) -> tuple[Plot, ...]:
    """Return the plots of a run, in the order in which they are shown.

    Args:
        stage: constants of the run.
        joints: number of joints of the arm; 0 without an arm.
    """
    tabs = {
        "Robot": _viewed("Robot", stage, joints),
        "Devices": device_plots(stage),
        "Sensors": sensor_plots(stage),
        "Interface": _viewed("Interface", stage, joints),
        "Energy": [] if stage.energy is None else _energy_plots(),
        "Run": [_with_tick_length(plot, stage) for plot in _viewed("Run", stage, joints)],
    }
    return tuple(
        replace(plot, tab=tab, colours=plot.colours or series_colours(len(plot.series)))
        for tab, plots in tabs.items()
        for plot in plots
        if plot.series and (joints or plot.entity not in _OF_AN_ARM)
    )


def _viewed(tab: str, stage: run_info.RunInfo, joints: int) -> list[Plot]:
    """Return the plots of the columns whose view is in a tab."""
    viewed = ((column, column.view) for column in columns_of(TickColumns).values() if column.view is not None)
    shown = sorted((pair for pair in viewed if pair[1].tab == tab), key=lambda pair: pair[1].place)
    return [_plot_of(column, view, stage, joints) for column, view in shown]


def _plot_of(column: Column, view: View, stage: run_info.RunInfo, joints: int) -> Plot:
    names = stage.names_along
    sizes = {axis: len(each) for axis, each in names.items()} | {
        "cables": len(stage.cables),
        "joints": joints,
    }
    shape = tuple(int(axis) if axis.isdigit() else sizes[axis] for axis in column.axes[1:])
    count, chosen = math.prod(shape), tuple(getattr(colours, name.upper()) for name in view.colours)
    alone = count == len(chosen) == 1
    series: tuple[str, ...] = (view.label,)
    if shape and not alone:
        numbers = [str(k) for k in range(count)]
        named = column.components({} if view.numbered else names, shape)
        series = tuple(f"{view.label} {k + 1}" for k in range(count)) if named == numbers else tuple(named)
    legend = view.legend and not (shape and alone)
    shown = chosen if len(chosen) == len(series) else ()
    return Plot(
        view.entity, view.title, series, partial(_shown, column.name, view), shown, legend, view.peaks
    )


def _shown(name: str, view: View, batch: tick_batch.TickBatch) -> Array:
    values = view.scale * getattr(batch, name)
    return np.log10(np.maximum(values, SMALLEST_LOGARITHM)) if view.log else np.asarray(values)


def _with_tick_length(plot: Plot, stage: run_info.RunInfo) -> Plot:
    """Return the cost of a tick in time with the tick's length as a second curve; others as they are."""
    if plot.entity != "tick_cost" or stage.mode != "dynamic":
        return plot

    def both(batch: tick_batch.TickBatch) -> Array:
        return np.stack([plot.values(batch), np.full(len(batch), 1e3 * stage.tick_s)], axis=1)

    return replace(plot, series=(*plot.series, "tick length"), values=both, colours=[ORANGE, GREY])


def _energy_plots() -> list[Plot]:
    held = {"kinetic_J": SKY, "elastic_J": GREEN, "rest_J": PINK}
    kinetic, *sparse = (
        Plot(f"energy/held/{name}", "", (_called(name),), partial(_energies, (name,)), [colour])
        for name, colour in held.items()
    )
    return [
        _energy_plot("put_in", "Energy put in [J]", PUT_IN + BETWEEN),
        _energy_plot("lost", "Energy lost [J]", LOST + MADE),
        replace(kinetic, entity="energy/held", title="Energy held, and rest of the balance [J]"),
        *sparse,  # known at some ticks only
    ]


def _energy_plot(entity: str, title: str, terms: tuple[str, ...]) -> Plot:
    return Plot(f"energy/{entity}", title, tuple(map(_called, terms)), partial(_energies, terms))


def _called(term: str) -> str:
    return term.removesuffix("_J").replace("_", " ")


def _energies(terms: tuple[str, ...], batch: tick_batch.TickBatch) -> Array:
    return batch.energy_J[:, [TERMS.index(term) for term in terms]]
