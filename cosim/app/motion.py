"""The motion of a robot: for its controller, with the payload on the flange; and back from what was measured.

The file is a table as `cosim export-path` writes it: joints, pressures and tensions over time. Beside them
stand columns of what was measured: those of `MEASURED`, and `JOINT.measured_rad` (`JOINT.measured_m`).
A measured curve y(t) is compared with the simulated x(t) at the delay d for which y(t) - x(t - d) varies
least; its mean is the bias, which is no matter of time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.app import ended_run
from cosim.app.payload import interpolated_rows, payload_rows
from cosim.app.preparation import build_simulation, log, prepared
from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array, IntArray, Mask
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import Command
from cosim.errors import InputError, SolverError
from cosim.results.exports import PAYLOAD, JointTable, sample_times
from cosim.results.result import RunResult, figure_kind, result_of
from cosim.telemetry import run_info
from cosim.telemetry.holding import held_parts

if TYPE_CHECKING:
    from cosim.plan.plan import PhasePlan
    from cosim.stepping.stepped_run import SteppedRun


_RATE_Hz: Final = 500.0


def plan_path(
    scenario: str | Path | Scenario,
    *,
    phase: str | None = None,
    whole: bool = False,
    rate_Hz: float = _RATE_Hz,
    overrides: Mapping[str, Any] | None = None,
) -> JointTable:
    """Return the joint angles, tensions and pressures that a scenario asks for; nothing is run.

    Of a single phase, that is its ramp; of a whole scenario, all ramps and the times to settle after them.
    What only a run knows is not there: sealed gas, controllers, the payload; see `run_path`.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        phase: which; None for the only one with a tip path.
        whole: all phases, one after the other.
        rate_Hz: of the controller, rows per second.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong, has no arm or no such phase, or its path cannot be followed.
    """
    checked = load_scenario(scenario, overrides)
    wanted = [entry.name for entry in checked.phases]
    if not whole:
        wanted = [_phase_of(checked, phase)]
    elif phase is not None:
        raise InputError(f"{checked.name}: give a phase ({phase!r}) or the whole, not both")
    run = _planned(prepared(checked, log))
    if not run.stage.joint_names:
        raise InputError(f"{checked.name}: has no arm whose joints could be written")
    rows = _rows([entry for entry in run.plan.phases if entry.phase.name in wanted], whole, rate_Hz)
    return _table(checked.name if whole else wanted[0], run, rows, checked.soft_robot.cable_names())


def _phase_of(scenario: Scenario, phase: str | None) -> str:
    names = [entry.name for entry in scenario.phases]
    if phase is not None and phase not in names:
        raise InputError(f"{scenario.name}: has no phase {phase!r}; it has {', '.join(names) or 'none'}")
    along = [entry.name for entry in scenario.phases if entry.tip_path is not None]
    if phase is None and len(along) != 1:
        raise InputError(
            f"{scenario.name}: {len(along)} phases have a tip_path; name a phase ({', '.join(names)}), or "
            "take the whole (--whole, whole=True)"
        )
    return phase or along[0]


def _planned(scenario: Scenario) -> SteppedRun:
    from cosim.build.simulation import build  # here: wrong input is refused before MuJoCo is imported

    return build(scenario)


@final
@dataclass(frozen=True, eq=False)
class _Rows:
    """Instants of phases one after the other.

    Args:
        time_s: (n,), from 0 on.
        phases: with their first row and the one after their last.
        within_s: (n,), since the begin of the row's phase.
    """

    time_s: Array
    phases: Sequence[tuple[PhasePlan, int, int]]
    within_s: Array


def _rows(phases: Sequence[PhasePlan], settles: bool, rate_Hz: float) -> _Rows:
    lasting = [p.phase.duration_s + (p.phase.settle_s if settles else 0.0) for p in phases]
    ends = np.cumsum(lasting)
    time_s = sample_times(float(ends[-1]), rate_Hz)
    which = np.minimum(np.searchsorted(ends, time_s, side="left"), len(phases) - 1)
    first = np.searchsorted(which, np.arange(len(phases) + 1))
    placed = [(p, first[k], first[k + 1]) for k, p in enumerate(phases) if first[k] < first[k + 1]]
    return _Rows(time_s, placed, time_s - (ends - lasting)[which])


def _table(name: str, run: SteppedRun, rows: _Rows, cables: Sequence[str]) -> JointTable:
    from cosim.plan.commands import CommandRamp
    from cosim.plan.ramp import progress

    joints, asked = [], []
    for planned, first, end in rows.phases:
        phase, times = planned.phase, rows.within_s[first:end]
        instants = [progress(phase.ramp, min(t, phase.duration_s), phase.duration_s) for t in times.tolist()]
        ramp = CommandRamp(planned.begin, planned.end)
        joints.append(planned.joints.through(instants).position)
        asked += [ramp.at(instant.value) for instant in instants]
    tension = np.array([command.cable_tension_N for command in asked]).reshape(len(asked), -1)
    length = np.array([command.cable_length_m for command in asked], float).reshape(len(asked), -1)
    pressure = np.array([command.pressure_Pa for command in asked]).reshape(len(asked), -1)
    given = [k for k in range(pressure.shape[1]) if not any(p.gas[k].sealed for p, _, _ in rows.phases)]
    heads, columns = _of_cables(cables, tension, length)
    chambers = run.stage.chamber_names
    return JointTable(
        name,
        (*_joint_heads(run.stage), *heads, *(f"{chambers[k]}.pressure_Pa" for k in given)),
        rows.time_s,
        np.hstack([np.concatenate(joints), columns, pressure[:, given]]),
    )


def _joint_heads(stage: run_info.RunInfo) -> list[str]:
    pairs = zip(stage.joint_names, stage.sliding, strict=True)
    return [f"{name}.position_{'m' if slides else 'rad'}" for name, slides in pairs]


def _of_cables(names: Sequence[str], tension_N: Array, length_m: Array) -> tuple[list[str], Array]:
    """Return heads and columns of cables: the length where it is commanded throughout, the tension else."""
    by_length = np.isfinite(length_m).all(axis=0) & np.ones(len(names), dtype=bool)
    units = ["length_m" if drum else "tension_N" for drum in by_length.tolist()]
    heads = [f"{name}.{unit}" for name, unit in zip(names, units, strict=True)]
    return heads, np.where(by_length, length_m, tension_N)


def run_path(
    run: RunResult | str | Path, *, phase: str | None = None, rate_Hz: float = _RATE_Hz
) -> JointTable:
    """Return the target angles of a run, the pressures and tensions, and the payload on the flange.

    Joints between ticks by a cubic spline, all else linearly. Pressures and tensions are those that the run
    had, whoever gave them. The payload is the soft robot in its shape at that instant, what else is on the
    flange, and objects while it holds them, see `held_parts`.

    Args:
        run: its result, or its directory.
        phase: which; None for the whole run.
        rate_Hz: of the controller, rows per second.

    Raises:
        InputError: there is no such run or phase, it has no arm, or no time.
    """
    result = run if isinstance(run, RunResult) else ended_run.load_run(run)
    stage = result.stage
    if not stage.joint_names or stage.mode != "dynamic":
        lacks = "no time" if stage.joint_names else "no arm whose joints could be written"
        raise InputError(f"{stage.scenario}: the run has {lacks}")
    if phase is not None and phase not in stage.phase_names:
        raise InputError(f"the run has no phase {phase!r}; it has {', '.join(stage.phase_names)}")
    ticks = np.arange(len(result.tick))
    if phase is not None:
        ticks = np.flatnonzero(result.phase == stage.phase_names.index(phase))
        ticks = np.concatenate([[max(ticks[0] - 1, 0)], ticks]) if len(ticks) else ticks
    ticks = np.unique(ticks)
    if len(ticks) < _FEWEST:
        raise InputError(f"{stage.scenario}: the run has {len(ticks)} ticks to write; at least {_FEWEST}")
    return _sampled(result, ticks, phase or stage.scenario, rate_Hz)


_FEWEST: Final = 4


def _sampled(result: RunResult, ticks: IntArray, name: str, rate_Hz: float) -> JointTable:

    stage, time_s = result.stage, result.time_s[ticks] - result.time_s[ticks[0]]
    tension, drums = result.cable_tension_N[ticks], result.cable_unstretched_m[ticks]
    drums = drums if drums.size else np.full(tension.shape, np.nan)
    cables, along = _of_cables(stage.cable_names, tension, drums)
    chambers = [f"{chamber}.pressure_Pa" for chamber in stage.chamber_names]
    at = sample_times(float(time_s[-1]), rate_Hz)
    within = np.minimum(at, time_s[-1])
    others = np.hstack([along, result.chamber_pressure_Pa[ticks]])
    columns = [np.interp(within, time_s, column) for column in others.T]
    begin_s, held = float(result.time_s[ticks[0]]), held_parts(result.summary)
    spans = [replace(part, since_s=part.since_s - begin_s, until_s=part.until_s - begin_s) for part in held]
    spans = [part for part in spans if part.since_s < time_s[-1] and part.until_s > 0.0]
    columns += [*interpolated_rows(within, time_s, payload_rows(result)[ticks], spans).T]
    # the target of a tick is that of its begin
    asked = result.joint_target[np.minimum(ticks + 1, len(result.tick) - 1)]
    angles = CubicSpline(time_s, asked)(within)
    heads = (*_joint_heads(stage), *cables, *chambers, *PAYLOAD)
    return JointTable(name, heads, at, np.column_stack([angles, *columns]), tuple(spans))


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
        too_fast: rows that a joint reaches later, as they ask for more than its bound of speed.
    """

    result: RunResult
    begin_s: float
    compared: tuple[Compared, ...]
    too_fast: int = 0

    def __repr__(self) -> str:
        """Return a line for every measured column, and one for rows that are too fast."""
        rows = [
            f"{row.name}: rms {row.rms:.3g}, largest {row.largest:.3g}, bias {row.bias:.3g}; measured "
            f"{1e3 * row.delay_s:.0f} ms later (rms {row.rms_undelayed:.3g} without that delay)"
            for row in self.compared
        ]
        rows = rows or ["nothing was measured in that file"]
        if self.too_fast:
            rows.append(f"{self.too_fast} rows ask joints for more than their bound of speed: reached later")
        return "\n".join(rows)


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
    rows = _from_zero(table if isinstance(table, JointTable) else JointTable.read(table))
    checked = prepared(load_scenario(scenario, {**(overrides or {}), "phase": []}), log)
    run = build_simulation(checked)
    stage, tick_s = run.stage, run.stage.tick_s
    if rows.joint_names != stage.joint_names:
        raise InputError(
            f"{rows.name}: has the joints {', '.join(rows.joint_names) or 'none'}; the arm has "
            f"{', '.join(stage.joint_names) or 'none'}, in this order"
        )
    _check_columns(rows, stage)
    too_fast = _check_joints(rows, stage)
    begin = round(APPROACH_s / tick_s), round(SETTLE_s / tick_s)
    ticks = np.diff(np.round(rows.time_s / tick_s).astype(int)).tolist()
    speed = _speeds(rows)
    wanted = [_command(rows, k, speed) for k in range(len(rows.time_s))]
    steps = [(wanted[0], begin[0]), (Command(), begin[1]), *zip(wanted[1:], ticks, strict=True)]
    begin_s = sum(begin) * tick_s
    result = _driven(run, [step for step in steps if step[1]], checked.recording.frames_per_s)
    return Replayed(result, begin_s, _compared(result, rows, begin_s), too_fast)


def _from_zero(rows: JointTable) -> JointTable:
    """Return a table whose times are since its first row."""
    return replace(rows, time_s=rows.time_s - rows.time_s[0])


def _check_columns(rows: JointTable, stage: run_info.RunInfo) -> None:
    """Refuse columns that would have no effect.

    Raises:
        InputError: there is one.
    """
    measured = [*MEASURED, *_measured_joints(stage)]
    parts = {
        "pressure_Pa": stage.chamber_names,
        "tension_N": stage.cable_names,
        "length_m": stage.cable_names,
    }
    moved = [f"{name}.{unit}" for unit, names in parts.items() for name in names]
    known = [*_joint_heads(stage), *moved, *PAYLOAD, *measured]
    if unknown := [column for column in rows.columns if column not in known]:
        raise InputError(
            f"{rows.name}: has columns that are unknown: {', '.join(unknown)}; remove or rename them. Known "
            f"are commands {', '.join([*_joint_heads(stage), *moved])}; and measured {', '.join(measured)}"
        )


def _check_joints(rows: JointTable, stage: run_info.RunInfo) -> int:
    """Return how many rows ask for more than the joints' bound of speed.

    Raises:
        InputError: a joint is asked for beyond its bounds.
    """
    if stage.arm is None:
        return 0
    for time_s, joints in zip(rows.time_s.tolist(), rows.joints, strict=True):
        stage.arm.limits.check_measured(joints, f"{rows.name}: at {time_s:g} s, position")
    ways = np.diff(rows.joints, axis=0)
    return int(stage.arm.limits.too_fast(ways, np.diff(rows.time_s)).any(axis=1).sum())


def _driven(run: SteppedRun, steps: Sequence[tuple[Command, int]], frames_per_s: float) -> RunResult:
    """Return what a run shows that is commanded step by step."""
    batches = [run.advance(1).table]
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
    return curves | dict(zip(_measured_joints(result.stage), result.joint_position.T, strict=True))


def _measured_joints(stage: run_info.RunInfo) -> list[str]:
    """Return the names of columns of measured joints."""
    pairs = zip(stage.joint_names, stage.sliding, strict=True)
    return [f"{name}.measured_{'m' if slides else 'rad'}" for name, slides in pairs]


def _compare(name: str, measured: tuple[Array, Array], simulated: tuple[Array, Array]) -> Compared:
    """Return how a measured curve (times, values) differs from a simulated one.

    A delay at which less than half of the measured curve meets the simulated one is none.
    """
    times, values = measured

    def meets(delay_s: float) -> Mask:
        at = times - delay_s
        return np.asarray((at >= simulated[0][0]) & (at <= simulated[0][-1]))

    def apart(delay_s: float) -> Array:
        at, kept = times - delay_s, meets(delay_s)
        return np.asarray(values[kept] - np.interp(at[kept], *simulated))

    def size(delay_s: float) -> float:
        return float(np.sqrt(np.mean(apart(delay_s) ** 2)))

    delays = np.arange(-MOST_DELAY_s, MOST_DELAY_s + 0.5 * _DELAY_STEP_s, _DELAY_STEP_s)
    fewest = max(0.5 * len(times), 2.0)
    delays = np.array([delay for delay in delays.tolist() if meets(delay).sum() >= fewest])
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
    rows = _from_zero(rows)
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
