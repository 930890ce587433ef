"""Joint angles, pressures and tensions over time, for the robot's controller: of a plan, or of a run with the
payload on the flange.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.app import ended_run
from cosim.app.payload import interpolated_rows, payload_rows
from cosim.app.preparation import build_simulation, log
from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array, IntArray
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.joint_table import PAYLOAD, JointTable, sample_times
from cosim.results.result import RunResult
from cosim.telemetry.held_parts import held_parts
from cosim.telemetry.run_info import RunInfo

if TYPE_CHECKING:
    from cosim.plan.plan import PhasePlan
    from cosim.stepping.stepped_run import SteppedRun

_RATE_Hz: Final = 500.0
_LEAST_TICKS: Final = 4


def plan_path(
    scenario: str | Path | Scenario,
    *,
    phase: str | None = None,
    whole: bool = False,
    rate_Hz: float = _RATE_Hz,
    overrides: Mapping[str, Any] | None = None,
) -> JointTable:
    """Return the planned joint angles, tensions and pressures of a scenario; nothing is run.

    For a single phase this is its ramp; for a whole scenario, all ramps, each with the time to settle after
    it. The results of a run are not included: sealed gas, controllers, the payload; see `run_path`.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        phase: its name; None for the only phase with a tip path.
        whole: whether all phases are planned, one after the other.
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
        raise InputError(f"{checked.name}: give a phase ({phase!r}) or whole=True, not both")
    run = build_simulation(checked, tell=log)
    if not run.stage.joint_names:
        raise InputError(f"{checked.name}: has no arm, so there are no joints to write")
    phases = [entry for entry in run.plan.phases if entry.phase.name in wanted]
    ends_s = np.cumsum(_lengths_s(phases, whole))
    time_s = sample_times(float(ends_s[-1]), rate_Hz)
    rows = _rows(phases, whole, time_s, ends_s)
    return _table(checked.name if whole else wanted[0], run, time_s, rows)


def _phase_of(scenario: Scenario, phase: str | None) -> str:
    names = [entry.name for entry in scenario.phases]
    if phase is not None and phase not in names:
        raise InputError(f"{scenario.name}: has no phase {phase!r}; it has {', '.join(names) or 'none'}")
    along = [entry.name for entry in scenario.phases if entry.tip_path is not None]
    if phase is None and len(along) != 1:
        raise InputError(
            f"{scenario.name}: {len(along)} phases have a tip_path; name a phase ({', '.join(names)}), or "
            "choose all phases (--whole, whole=True)"
        )
    return phase or along[0]


@final
@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a table within one phase.

    Args:
        planned: the phase.
        within_s: (n,), times since its start.
    """

    planned: PhasePlan
    within_s: Array


def _rows(phases: Sequence[PhasePlan], settles: bool, time_s: Array, ends_s: Array) -> list[_Rows]:
    """Return the rows of each phase that has any, at times (n,) since the start of the first phase."""
    which = np.minimum(np.searchsorted(ends_s, time_s, side="left"), len(phases) - 1)
    within_s = time_s - (ends_s - _lengths_s(phases, settles))[which]
    rows = [_Rows(planned, within_s[which == k]) for k, planned in enumerate(phases)]
    return [each for each in rows if len(each.within_s)]


def _lengths_s(phases: Sequence[PhasePlan], settles: bool) -> list[float]:
    return [p.phase.duration_s + (p.phase.settle_s if settles else 0.0) for p in phases]


def _table(name: str, run: SteppedRun, time_s: Array, rows: Sequence[_Rows]) -> JointTable:
    from cosim.plan.commands import CommandRamp
    from cosim.plan.ramp import progress

    stage, joints, commands = run.stage, [], []
    for each in rows:
        planned, phase = each.planned, each.planned.phase
        times = [min(t, phase.duration_s) for t in each.within_s.tolist()]
        instants = [progress(phase.ramp, t, phase.duration_s) for t in times]
        ramp = CommandRamp(planned.begin, planned.end)
        joints.append(planned.joints.through(instants).position)
        commands += [ramp.at(instant.value) for instant in instants]
    tension = np.array([command.cable_tension_N for command in commands]).reshape(len(commands), -1)
    length = np.array([command.cable_length_m for command in commands], float).reshape(len(commands), -1)
    pressure = np.array([command.pressure_Pa for command in commands]).reshape(len(commands), -1)
    open_ = [k for k in range(pressure.shape[1]) if not any(each.planned.gas[k].sealed for each in rows)]
    heads, columns = _of_cables(stage.cable_names, tension, length)
    return JointTable(
        name,
        (*joint_heads(stage), *heads, *(f"{stage.chamber_names[k]}.pressure_Pa" for k in open_)),
        time_s,
        np.hstack([np.concatenate(joints), columns, pressure[:, open_]]),
    )


def joint_heads(stage: RunInfo) -> list[str]:
    """Return the heads of the columns of joints."""
    pairs = zip(stage.joint_names, stage.sliding, strict=True)
    return [f"{name}.position_{'m' if slides else 'rad'}" for name, slides in pairs]


def _of_cables(names: Sequence[str], tension_N: Array, length_m: Array) -> tuple[list[str], Array]:
    """Return heads and columns of cables: the length if it is commanded throughout, otherwise the tension."""
    by_length = np.isfinite(length_m).all(axis=0) & np.ones(len(names), dtype=bool)
    units = ["length_m" if drum else "tension_N" for drum in by_length.tolist()]
    heads = [f"{name}.{unit}" for name, unit in zip(names, units, strict=True)]
    return heads, np.where(by_length, length_m, tension_N)


def run_path(
    run: RunResult | str | Path, *, phase: str | None = None, rate_Hz: float = _RATE_Hz
) -> JointTable:
    """Return the target angles of a run, its pressures and tensions, and the payload on the flange.

    Joints are interpolated by a cubic spline, all other columns linearly. Pressures and tensions are those of
    the run, commanded or not. The payload is the soft robot in its present shape, everything else that is
    fixed to the flange, and objects while they are held, see `held_parts`.

    Args:
        run: its result, or its directory.
        phase: its name; None for the whole run.
        rate_Hz: of the controller, rows per second.

    Raises:
        InputError: there is no such run or phase, or the run is quasi-static or has no arm.
    """
    result = run if isinstance(run, RunResult) else ended_run.load_run(run)
    stage = result.stage
    if not stage.joint_names or stage.mode != "dynamic":
        lacks = "is quasi-static, it has no time" if stage.joint_names else "has no arm, it has no joints"
        raise InputError(f"{stage.scenario}: the run {lacks}")
    if phase is not None and phase not in stage.phase_names:
        raise InputError(f"the run has no phase {phase!r}; it has {', '.join(stage.phase_names)}")
    ticks = np.arange(len(result.tick))
    if phase is not None:
        ticks = np.flatnonzero(result.phase == stage.phase_names.index(phase))
        ticks = np.concatenate([[max(ticks[0] - 1, 0)], ticks]) if len(ticks) else ticks
    ticks = np.unique(ticks)
    if len(ticks) < _LEAST_TICKS:
        raise InputError(f"{stage.scenario}: the run has {len(ticks)} ticks to write; needs {_LEAST_TICKS}")
    return _sampled(result, ticks, phase or stage.scenario, rate_Hz)


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
    # the target of a tick is that of its start
    target = result.joint_target[np.minimum(ticks + 1, len(result.tick) - 1)]
    angles = CubicSpline(time_s, target)(within)
    heads = (*joint_heads(stage), *cables, *chambers, *PAYLOAD)
    return JointTable(name, heads, at, np.column_stack([angles, *columns]), tuple(spans))
