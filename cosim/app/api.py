"""Running a scenario from Python, and exporting its tip paths.

Planned tip paths for the controllers of robots.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.app.driver import (
    Observer,
    Options,
    build_simulation,
    execute,
    log,
    named_body,
    prepared,
    rerun_recorder,
)
from cosim.app.run_files import default_directory
from cosim.base.files import cache_directory
from cosim.base.kept_parts import KeptParts
from cosim.config.loading import load_scenario
from cosim.config.rules import check_ends
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError, RunInterrupted
from cosim.results.joint_table import JointTable, sample_times
from cosim.results.result import ResultBuilder, RunResult
from cosim.telemetry.figures import branching_lines, standing_lines

if TYPE_CHECKING:
    from cosim.build.soft_body import AnyBody
    from cosim.devices.controller import AnyController
    from cosim.plan.plan import PhasePlan
    from cosim.stepping.stepped_run import SteppedRun


def run(
    scenario: str | Path | Scenario,
    *,
    overrides: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    recording: bool = False,
    controllers: Mapping[str, AnyController] | None = None,
    body: AnyBody | None = None,
    observers: Sequence[Observer] = (),
    error: bool | None = None,
) -> RunResult:
    """Run a scenario and return its arrays.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        overrides: values by key path, such as {"mode": "quasistatic", "phase.inflate.pressure_Pa": 20e3}.
        out: directory for scenario.toml, summary.json and the recording; None writes none unless a
            recording is asked for, which then goes to `runs/`.
        recording: whether to write `recording.rrd`.
        controllers: the scenario's controllers of kind "python", by name.
        body: a soft body in place of the scenario's soft robot; its files cannot be resumed without it.
        observers: shown all ticks while the run lasts.
        error: whether to work out how far its figures may be off; None: at all phase ends where that costs at
            most a third of the run, else at the last, or not where even that costs far more than the run.

    Raises:
        InputError: the scenario is wrong or asks for what cannot be reached.
        SolverError: the physics could not be solved; `result` of the error holds the arrays until then, as it
            does of whatever else is raised in the middle of a run, such as by a controller.
        RunInterrupted: by Ctrl-C; the same.
    """
    started = time.perf_counter()
    named = named_body(body)
    loaded = load_scenario(scenario, overrides, named and named.table())
    check_ends(loaded)
    kept = KeptParts(cache_directory())
    checked = prepared(loaded, log, recording=recording, kept=kept)
    directory = Path(out) if out is not None else default_directory(checked.name) if recording else None
    arrays = ResultBuilder(checked.recording.frames_per_s)
    recorder = rerun_recorder if recording else None
    options = Options(directory, recorder, [arrays, *observers], error=error, tell=log)
    given: dict[str, Any] = {"controllers": controllers, "body": named and named.body, "tell": log}
    given["kept"] = kept
    build = partial(build_simulation, **{key: value for key, value in given.items() if value is not None})
    outcome = execute(checked, build, options, started)
    result = arrays.result(outcome.summary, directory)
    stability = branching_lines(outcome.summary["branchings"]), standing_lines(outcome.summary["phases"])
    for line in (*outcome.summary["warnings"], *stability[0], *stability[1]):
        log(line)
    if outcome.error is None:
        return result
    interrupted = isinstance(outcome.error, KeyboardInterrupt)
    raised = RunInterrupted(*outcome.error.args) if interrupted else outcome.error
    vars(raised)["result"] = result
    if directory is not None:
        raised.add_note(f"what was simulated is in {directory}")
    raise raised from outcome.error.__cause__ if raised is outcome.error else outcome.error


def plan_path(
    scenario: str | Path | Scenario,
    *,
    phase: str | None = None,
    rate_Hz: float = 500.0,
    overrides: Mapping[str, Any] | None = None,
) -> JointTable:
    """Return the joint angles, tensions and pressures that lead the tip along a path; nothing is run.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        phase: that has the path; None for the only one that has.
        rate_Hz: of the controller, rows per second.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong, its path cannot be followed, or it has none, or several.
    """
    checked = load_scenario(scenario, overrides)
    names = [entry.name for entry in checked.phases if entry.tip_path is not None]
    if phase not in names and (phase is not None or len(names) != 1):
        which = (
            f"phase {phase!r} has no tip_path"
            if phase is not None
            else f"{len(names)} phases have a tip_path"
        )
        raise InputError(f"{checked.name}: {which}; name one that has: {', '.join(names) or '(none)'}")
    simulation = _planned(prepared(checked, log, recording=False))
    wanted = phase or names[0]
    planned = next(entry for entry in simulation.plan.phases if entry.phase.name == wanted)
    cables, chambers = checked.soft_robot.cable_names(), simulation.stage.chamber_names
    return _table(planned, simulation, tuple(cables), chambers, rate_Hz)


def _planned(scenario: Scenario) -> SteppedRun:
    from cosim.build.simulation import build  # here: wrong input is refused before MuJoCo is imported

    return build(scenario)


def _table(
    planned: PhasePlan, run: SteppedRun, cables: tuple[str, ...], chambers: tuple[str, ...], rate_Hz: float
) -> JointTable:
    from cosim.plan.motion import progress
    from cosim.plan.plan import CommandRamp

    phase = planned.phase
    time_s = sample_times(phase.duration_s, rate_Hz)
    instants = [progress(phase.ramp, t, phase.duration_s) for t in time_s.tolist()]
    ramp = CommandRamp(planned.begin, planned.end)
    asked = [ramp.at(instant.value) for instant in instants]
    given = [k for k, rule in enumerate(planned.gas) if not rule.sealed]
    sliding = np.zeros(0, bool) if run.stage.arm is None else run.stage.arm.limits.prismatic
    units = ["m" if slides else "rad" for slides in sliding]
    joints = [f"{name}.position_{unit}" for name, unit in zip(run.stage.joint_names, units, strict=True)]
    values = [
        planned.joints.through(instants).position,
        np.array([command.cable_tension_N for command in asked]).reshape(len(asked), -1),
        np.array([[command.pressure_Pa[k] for k in given] for command in asked]).reshape(len(asked), -1),
    ]
    heads = [
        *joints,
        *(f"{name}.tension_N" for name in cables),
        *(f"{chambers[k]}.pressure_Pa" for k in given),
    ]
    return JointTable(phase.name, tuple(heads), time_s, np.concatenate(values, axis=1))
