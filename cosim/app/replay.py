"""Replays a table of joints, pressures and tensions in simulation, and compares measured columns with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.app.joint_paths import joint_heads
from cosim.app.preparation import build_simulation, log
from cosim.base.frames import Array, Mask
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import Command
from cosim.errors import InputError, SolverError
from cosim.results.joint_table import PAYLOAD, JointTable
from cosim.results.plots import figure_kind
from cosim.results.result import RunResult
from cosim.results.result_builder import result_of
from cosim.telemetry.run_info import RunInfo

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun

APPROACH_s: Final = 2.0
"""Time in which the robot moves to the first row, before the replay begins."""
SETTLE_s: Final = 1.0
"""Time that it waits there."""
MEASURED: Final = {
    "tip.x_m": ("tip_position", 0), "tip.y_m": ("tip_position", 1), "tip.z_m": ("tip_position", 2),
    "flange.force_x_N": ("flange_force", 0), "flange.force_y_N": ("flange_force", 1),
    "flange.force_z_N": ("flange_force", 2), "flange.torque_x_Nm": ("flange_torque", 0),
    "flange.torque_y_Nm": ("flange_torque", 1), "flange.torque_z_Nm": ("flange_torque", 2),
}  # fmt: skip
"""Measured columns, world axes, with the array of the result that each is compared with and its column there;
further ones are `JOINT.measured_rad` and `JOINT.measured_m`.
"""
MOST_DELAY_s: Final = 0.5
_DELAY_STEP_s: Final = 1e-3
_ROUGH_rad_s2: Final = 30.0
"""Acceleration above which rows are noisy."""
_MOVES: Final = {"tension_N": "cable_tension_N", "length_m": "cable_length_m", "pressure_Pa": "pressure_Pa"}
"""Field of a command, by the unit of a column."""


@final
@dataclass(frozen=True, eq=False)
class _Curve:
    """A quantity over time.

    Args:
        time_s: (n,).
        values: (n,).
    """

    time_s: Array
    values: Array


@final
@dataclass(frozen=True)
class Compared:
    """Differences between a measured and a simulated curve, measured less simulated.

    Args:
        name: of the column.
        delay_s: of the measured curve.
        rms: root mean square of the differences at that delay, in the unit at the end of the name.
        largest: of these differences, in magnitude.
        rms_undelayed: root mean square without the delay.
        bias: mean difference at the delay.
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
        result: the run.
        begin_s: time in the run when the robot is at the first row and the replay begins.
        compared: measured columns, compared with the run.
        too_fast: number of rows that a joint reaches later because of its bound of speed.
    """

    result: RunResult
    begin_s: float
    compared: tuple[Compared, ...]
    too_fast: int = 0

    def __repr__(self) -> str:
        """Return a line for each measured column, and one for rows that are too fast."""
        rows = [
            f"{row.name}: rms {row.rms:.3g}, largest {row.largest:.3g}, bias {row.bias:.3g}; measured "
            f"{1e3 * row.delay_s:.0f} ms later (rms {row.rms_undelayed:.3g} without that delay)"
            for row in self.compared
        ]
        rows = rows or ["the file has no measured columns"]
        if self.too_fast:
            rows.append(f"{self.too_fast} rows exceed a joint's bound of speed and are reached later")
        return "\n".join(rows)


@final
@dataclass(frozen=True)
class _TimedCommand:
    """A command, and the ticks within which it is reached."""

    command: Command
    ticks: int


def replay(
    scenario: str | Path | Scenario,
    table: JointTable | str | Path,
    *,
    overrides: Mapping[str, Any] | None = None,
) -> Replayed:
    """Drive a scenario's robot by a table of joints, pressures and tensions, and compare measured columns.

    The scenario's phases are skipped. The robot begins at the scenario's start, moves to the first row in
    2 s, waits for 1 s, and then follows the rows, along a cubic from one to the next. If rows are noisy, with
    accelerations above 30 rad/s^2, it moves at constant speed between them.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        table: or its .csv file.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong, or the table names parts that the robot does not have.
        SolverError: the physics could not be solved.
    """
    rows = _from_zero(table if isinstance(table, JointTable) else JointTable.read(table))
    checked = load_scenario(scenario, {**(overrides or {}), "phase": []})
    run = build_simulation(checked, tell=log)
    stage, tick_s = run.stage, run.stage.tick_s
    if rows.joint_names != stage.joint_names:
        raise InputError(
            f"{rows.name}: has the joints {', '.join(rows.joint_names) or 'none'}; the arm has "
            f"{', '.join(stage.joint_names) or 'none'}, in this order"
        )
    _check_columns(rows, stage)
    too_fast = _check_joints(rows, stage)
    approach, settle = round(APPROACH_s / tick_s), round(SETTLE_s / tick_s)
    ticks = np.diff(np.round(rows.time_s / tick_s).astype(int)).tolist()
    speed = _speeds(rows)
    first, *others = (_command(rows, k, speed) for k in range(len(rows.time_s)))
    steps = [
        _TimedCommand(first, approach),
        _TimedCommand(Command(), settle),
        *map(_TimedCommand, others, ticks),
    ]
    begin_s = (approach + settle) * tick_s
    result = _driven(run, [step for step in steps if step.ticks], checked.recording.frames_per_s)
    return Replayed(result, begin_s, _compared(result, rows, begin_s), too_fast)


def _from_zero(rows: JointTable) -> JointTable:
    """Return a table whose times begin at 0."""
    return replace(rows, time_s=rows.time_s - rows.time_s[0])


def _check_columns(rows: JointTable, stage: RunInfo) -> None:
    """Check that every column is known.

    Raises:
        InputError: a column is unknown.
    """
    measured = [*MEASURED, *_measured_joints(stage)]
    parts = {
        "pressure_Pa": stage.chamber_names,
        "tension_N": stage.cable_names,
        "length_m": stage.cable_names,
    }
    moved = [f"{name}.{unit}" for unit, names in parts.items() for name in names]
    known = [*joint_heads(stage), *moved, *PAYLOAD, *measured]
    if unknown := [column for column in rows.columns if column not in known]:
        raise InputError(
            f"{rows.name}: unknown columns {', '.join(unknown)}; remove or rename them. Known columns "
            f"are commands {', '.join([*joint_heads(stage), *moved])}; and measured {', '.join(measured)}"
        )


def _check_joints(rows: JointTable, stage: RunInfo) -> int:
    """Return the number of rows that exceed a joint's bound of speed.

    Raises:
        InputError: a joint's position is beyond its bounds.
    """
    if stage.arm is None:
        return 0
    for time_s, joints in zip(rows.time_s.tolist(), rows.joints, strict=True):
        stage.arm.limits.check_measured(joints, f"{rows.name}: at {time_s:g} s, position")
    ways = np.diff(rows.joints, axis=0)
    return int(stage.arm.limits.too_fast(ways, np.diff(rows.time_s)).any(axis=1).sum())


def _driven(run: SteppedRun, steps: Sequence[_TimedCommand], frames_per_s: float) -> RunResult:
    """Return the result of a run that is commanded step by step."""
    batches = [run.advance(1).table]
    try:
        for step in steps:
            run.command(step.command, step.ticks)
            batches += run.batches(most=step.ticks)
    except SolverError as error:
        vars(error)["result"] = result_of(run.stage, frames_per_s, batches, error)
        raise
    return result_of(run.stage, frames_per_s, batches)


def _speeds(rows: JointTable) -> Array | None:
    """Return the speeds (n, joints) of the joints; None for noisy rows."""
    steps = np.diff(rows.joints, axis=0) / np.diff(rows.time_s)[:, None]
    change = np.abs(np.diff(steps, axis=0)) / np.diff(rows.time_s)[1:, None]
    return rows.joint_speeds if change.max(initial=0.0) <= _ROUGH_rad_s2 else None


def _command(rows: JointTable, k: int, speed: Array | None) -> Command:
    """Return the command of a row."""
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
    time_s = result.time_s - begin_s
    return tuple(
        _compare(name, _Curve(rows.time_s, rows.values[:, k]), _Curve(time_s, curves[name]))
        for k, name in enumerate(rows.columns)
        if name in curves
    )


def _curves(result: RunResult) -> dict[str, Array]:
    """Return the simulated values of measured columns, by name."""
    curves: dict[str, Array] = {name: getattr(result, array)[:, k] for name, (array, k) in MEASURED.items()}
    return curves | dict(zip(_measured_joints(result.stage), result.joint_position.T, strict=True))


def _measured_joints(stage: RunInfo) -> list[str]:
    """Return the names of columns of measured joints."""
    pairs = zip(stage.joint_names, stage.sliding, strict=True)
    return [f"{name}.measured_{'m' if slides else 'rad'}" for name, slides in pairs]


def _compare(name: str, measured: _Curve, simulated: _Curve) -> Compared:
    """Return the differences between two curves.

    At the delay d of a measured y(t), y(t) - x(t - d) from the simulated x varies least; its mean is the
    bias, which no delay explains. At least half of the measured curve must overlap the simulated one.
    """

    def overlap(delay_s: float) -> Mask:
        at = measured.time_s - delay_s
        return np.asarray((at >= simulated.time_s[0]) & (at <= simulated.time_s[-1]))

    def difference(delay_s: float) -> Array:
        at, rows = measured.time_s - delay_s, overlap(delay_s)
        return np.asarray(measured.values[rows] - np.interp(at[rows], simulated.time_s, simulated.values))

    def rms(delay_s: float) -> float:
        return float(np.sqrt(np.mean(difference(delay_s) ** 2)))

    delays = np.arange(-MOST_DELAY_s, MOST_DELAY_s + 0.5 * _DELAY_STEP_s, _DELAY_STEP_s)
    least = max(0.5 * len(measured.time_s), 2.0)
    delays = np.array([delay for delay in delays.tolist() if overlap(delay).sum() >= least])
    best = float(delays[int(np.argmin([np.std(difference(delay)) for delay in delays.tolist()]))])
    left = difference(best)
    return Compared(name, best, rms(best), float(np.abs(left).max()), rms(0.0), float(left.mean()))


def drawn(found: Replayed, rows: JointTable) -> Any:
    """Return a matplotlib figure of measured and simulated curves, at the times of the file.

    Args:
        found: result of `replay`.
        rows: the replayed table.

    Raises:
        InputError: there is no measured column, or matplotlib is not installed.
    """
    figure_class = figure_kind()
    if not found.compared:
        raise InputError(f"{rows.name}: has no measured column, such as {', '.join(MEASURED)}")
    figure = figure_class(figsize=(9.0, 2.2 * len(found.compared) + 0.6), layout="constrained")
    rows = _from_zero(rows)
    axes = figure.subplots(len(found.compared), 1, sharex=True, squeeze=False).ravel()
    curves = _curves(found.result)
    for plot, row in zip(axes, found.compared, strict=True):
        plot.plot(rows.time_s, rows.values[:, rows.columns.index(row.name)], lw=1.0, label="measured")
        plot.plot(found.result.time_s - found.begin_s, curves[row.name], lw=1.0, label="simulated")
        plot.set_title(f"{row.name}: rms {row.rms:.3g}, {1e3 * row.delay_s:.0f} ms later", fontsize=9)
        plot.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    axes[0].set_xlim(rows.time_s[0], rows.time_s[-1])
    axes[-1].set_xlabel("time [s]")
    return figure
