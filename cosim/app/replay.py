"""A scenario driven by what a robot was asked for, and compared with what was measured of it.

The file is a table as `cosim export-path` writes it: joints, pressures and tensions over time. Beside them
stand columns of what was measured: those of `MEASURED`, and `JOINT.measured_rad` (`JOINT.measured_m`).
A measured curve y(t) is compared with the simulated x(t) at the delay d for which y(t) - x(t - d) varies
least; its mean is the bias, which is no matter of time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.app.driver import build_simulation, log, prepared
from cosim.base.frames import Array
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import Command
from cosim.errors import InputError, SolverError
from cosim.results.exports import JointTable
from cosim.results.result import RunResult, figure_kind, result_of
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun

APPROACH_s: Final = 2.0
"""In which the robot goes evenly to the first row before the replay begins."""
SETTLE_s: Final = 1.0
"""For which it waits there."""
MEASURED: Final = {
    "tip.x_m": ("tip_position", 0), "tip.y_m": ("tip_position", 1), "tip.z_m": ("tip_position", 2),
    "flange.force_x_N": ("flange_force", 0), "flange.force_y_N": ("flange_force", 1),
    "flange.force_z_N": ("flange_force", 2), "flange.torque_x_Nm": ("flange_torque", 0),
    "flange.torque_y_Nm": ("flange_torque", 1), "flange.torque_z_Nm": ("flange_torque", 2),
}  # fmt: skip
"""Columns of what was measured, in the world's axes, and the result's arrays that they are compared with."""
MOST_DELAY_s: Final = 0.5
_DELAY_STEP_s: Final = 1e-3
_ROUGH_rad_s2: Final = 30.0
_MOVES: Final = {"tension_N": "cable_tension_N", "length_m": "cable_length_m", "pressure_Pa": "pressure_Pa"}


@final
@dataclass(frozen=True)
class Compared:
    """One measured curve beside the simulated one.

    Args:
        name: of the column.
        delay_s: by which the measured curve is later.
        rms: root mean square of what they differ by at that delay, in the unit that the name ends in.
        largest: of these differences.
        rms_undelayed: root mean square without the delay.
        bias: mean of measured less simulated, at the delay.
    """

    name: str
    delay_s: float
    rms: float
    largest: float
    rms_undelayed: float
    bias: float


@final
@dataclass(frozen=True, eq=False)
class Replayed:
    """A replayed run.

    Args:
        result: the run; the replay begins at `begin_s` of it, when the robot stands at the first row.
        begin_s: see above.
        compared: measured columns beside the run.
    """

    result: RunResult
    begin_s: float
    compared: tuple[Compared, ...]

    def __repr__(self) -> str:
        """Return a line for every measured column."""
        rows = [
            f"{row.name}: rms {row.rms:.3g}, largest {row.largest:.3g}, bias {row.bias:.3g}; measured "
            f"{1e3 * row.delay_s:.0f} ms later (rms {row.rms_undelayed:.3g} without that delay)"
            for row in self.compared
        ]
        return "\n".join(rows or ["nothing was measured in that file"])


def replay(
    scenario: str | Path | Scenario,
    table: JointTable | str | Path,
    *,
    overrides: Mapping[str, Any] | None = None,
) -> Replayed:
    """Drive a scenario's robot by a table of joints, pressures and tensions, and compare what was measured.

    The scenario's own phases are left out. The robot begins at the scenario's start, goes to the first row in
    2 s, waits for 1 s, and then follows the rows, along a cubic from one to the next. If rows are too rough
    for that, with accelerations above 30 rad/s^2 such as those of noise, it goes evenly.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        table: or its .csv file.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong, or the table names parts that the robot has not.
        SolverError: the physics could not be solved.
    """
    rows = table if isinstance(table, JointTable) else JointTable.read(table)
    checked = prepared(load_scenario(scenario, {**(overrides or {}), "phase": []}), log, recording=False)
    run = build_simulation(checked)
    stage, tick_s = run.stage, run.stage.tick_s
    if rows.joint_names != stage.joint_names:
        raise InputError(
            f"{rows.name}: has the joints {', '.join(rows.joint_names) or 'none'}; the arm has "
            f"{', '.join(stage.joint_names) or 'none'}, in this order"
        )
    begin = round(APPROACH_s / tick_s), round(SETTLE_s / tick_s)
    ticks = np.diff(np.round(rows.time_s / tick_s).astype(int)).tolist()
    speed = _speeds(rows)
    wanted = [_command(rows, k, speed) for k in range(len(rows.time_s))]
    steps = [(wanted[0], begin[0]), (Command(), begin[1]), *zip(wanted[1:], ticks, strict=True)]
    begin_s = sum(begin) * tick_s
    result = _driven(run, [step for step in steps if step[1]], checked.recording.frames_per_s)
    return Replayed(result, begin_s, _compared(result, rows, begin_s))


def _driven(run: SteppedRun, steps: Sequence[tuple[Command, int]], frames_per_s: float) -> RunResult:
    """Return what a run shows that is commanded step by step."""
    batches = [TickBatch.of([run.advance(1)])]
    try:
        for command, ticks in steps:
            run.command(command, ticks)
            batches += run.batches(most=ticks)
    except SolverError as error:
        vars(error)["result"] = result_of(run.stage, frames_per_s, batches, error)
        raise
    return result_of(run.stage, frames_per_s, batches)


def _speeds(rows: JointTable) -> Array | None:
    """Return the speed (n, joints) of the joints; None where they are rough."""
    steps = np.diff(rows.joints, axis=0) / np.diff(rows.time_s)[:, None]
    change = np.abs(np.diff(steps, axis=0)) / np.diff(rows.time_s)[1:, None]
    return rows.joint_speeds if change.max(initial=0.0) <= _ROUGH_rad_s2 else None


def _command(rows: JointTable, k: int, speed: Array | None) -> Command:
    """Return what a row asks for."""
    given: dict[str, Any] = {}
    for column, value in zip(rows.columns, rows.values[k].tolist(), strict=True):
        name, _, unit = column.rpartition(".")
        if unit in _MOVES:
            given.setdefault(_MOVES[unit], {})[name] = value
    if speed is not None:
        given["joint_velocity"] = speed[k]
    return Command(joint_position=rows.joints[k], **given)


def _compared(result: RunResult, rows: JointTable, begin_s: float) -> tuple[Compared, ...]:
    curves = _curves(result)
    found = (
        _compare(name, (rows.time_s, rows.values[:, k]), (result.time_s - begin_s, curves[name]))
        for k, name in enumerate(rows.columns)
        if name in curves
    )
    return tuple(found)


def _curves(result: RunResult) -> dict[str, Array]:
    """Return what a run has to compare with, by column."""
    curves: dict[str, Array] = {name: getattr(result, array)[:, k] for name, (array, k) in MEASURED.items()}
    for k, joint in enumerate(result.stage.joint_names):
        unit = "m" if result.stage.sliding[k] else "rad"
        curves[f"{joint}.measured_{unit}"] = result.joint_position[:, k]
    return curves


def _compare(name: str, measured: tuple[Array, Array], simulated: tuple[Array, Array]) -> Compared:
    """Return how a measured curve (times, values) differs from a simulated one."""
    times, values = measured

    def apart(delay_s: float) -> Array:
        at = times - delay_s
        kept = (at >= simulated[0][0]) & (at <= simulated[0][-1])
        return np.asarray(values[kept] - np.interp(at[kept], *simulated))

    def size(delay_s: float) -> float:
        return float(np.sqrt(np.mean(apart(delay_s) ** 2)))

    delays = np.arange(-MOST_DELAY_s, MOST_DELAY_s + 0.5 * _DELAY_STEP_s, _DELAY_STEP_s)
    best = float(delays[int(np.argmin([np.std(apart(delay)) for delay in delays.tolist()]))])
    left = apart(best)
    return Compared(name, best, size(best), float(np.abs(left).max()), size(0.0), float(left.mean()))


def drawn(found: Replayed, rows: JointTable) -> Any:
    """Return a matplotlib figure of measured and simulated curves, at the times of the file.

    Args:
        found: of `replay`.
        rows: that were replayed.

    Raises:
        InputError: nothing was measured, or there is no matplotlib.
    """
    figure_class = figure_kind()
    if not found.compared:
        raise InputError(f"{rows.name}: has no column of what was measured: {', '.join(MEASURED)}")
    figure = figure_class(figsize=(9.0, 2.2 * len(found.compared) + 0.6), layout="constrained")
    axes = figure.subplots(len(found.compared), 1, sharex=True, squeeze=False).ravel()
    curves = _curves(found.result)
    for place, row in zip(axes, found.compared, strict=True):
        place.plot(rows.time_s, rows.values[:, rows.columns.index(row.name)], lw=1.0, label="measured")
        place.plot(found.result.time_s - found.begin_s, curves[row.name], lw=1.0, label="simulated")
        place.set_title(f"{row.name}: rms {row.rms:.3g}, {1e3 * row.delay_s:.0f} ms later", fontsize=9)
        place.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    axes[0].set_xlim(rows.time_s[0], rows.time_s[-1])
    axes[-1].set_xlabel("time [s]")
    return figure
