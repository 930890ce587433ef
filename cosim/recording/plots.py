"""The curves of a recording: what is plotted, in which unit, under which name."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.recording.colours import (
    GREEN,
    GREY,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    WHITE,
    series_colours,
)
from cosim.recording.device_plots import device_plots
from cosim.recording.plot import Plot
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch

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
