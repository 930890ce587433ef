"""Runs scenarios from Python."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from cosim.app import driver, preparation
from cosim.app.error_bars import bars_finder
from cosim.app.run_files import default_directory
from cosim.app.run_follower import Observer, Options
from cosim.base import kept_parts
from cosim.config import loading, rules, several_arms
from cosim.config.schema.scenario import Scenario
from cosim.errors import RunInterrupted
from cosim.results.result import RunResult
from cosim.results.result_builder import ResultBuilder
from cosim.telemetry.texts.stability_lines import branching_lines, stability_lines

if TYPE_CHECKING:
    from cosim.build.given_body import AnyBody
    from cosim.devices.controller import AnyController


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
        out: directory for scenario.toml, summary.json and the recording; None writes no files, unless
            `recording` is set, which writes to `runs/`.
        recording: whether to write `recording.rrd`.
        controllers: the scenario's controllers of kind "python", by name.
        body: a soft body in place of the scenario's soft robot; its files cannot be resumed without it.
        observers: of all ticks while the run lasts.
        error: whether to compute error bars, as `cosim.error_bars` does; None: at all phase ends if that
            costs at most a quarter of the run, otherwise at the last, or nowhere if even that costs far more.

    Raises:
        InputError: the scenario is wrong or asks for what cannot be reached.
        SolverError: the physics could not be solved; `result` of the error has the arrays until then, as has
            any other error in a run, such as one of a controller.
        RunInterrupted: by Ctrl-C; the same.
    """
    started = time.perf_counter()
    named = preparation.named_body(body)
    checked = loading.load_scenario(scenario, overrides, named and named.table())
    rules.check_ends(checked)
    kept = kept_parts.KeptParts(on_disk=True)
    directory = Path(out) if out is not None else default_directory(checked.name) if recording else None
    arrays = ResultBuilder(checked.recording.frames_per_s)
    recorder = driver.rerun_recorder if recording else None
    find_bars = bars_finder(error, preparation.log, kept)
    options = Options(directory, recorder, [arrays, *observers], find_bars=find_bars)
    given: dict[str, Any] = {"controllers": controllers, "body": named and named.body, "kept": kept}
    given = {key: value for key, value in given.items() if value is not None}
    build = partial(preparation.build_simulation, tell=preparation.log, **given)
    outcome = driver.execute(checked, build, options, started)
    result = replace(arrays.result(outcome.summary, directory), scenario=checked, ends=outcome.ends)
    log_ending(outcome.summary)
    if outcome.error is not None:
        raise_ended(outcome.error, result, directory)
    return result


def run_arms(
    scenario: str | Path,
    *,
    overrides: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    recording: bool = False,
) -> dict[str, RunResult]:
    """Run a scenario of several arms and return the arrays of each, by its name.

    Args:
        scenario: name of a scenario that comes with cosim, or path of a .toml file with `[[arm]]`.
        overrides: values by key path, such as {"arm.left.phase.lift.duration_s": 2.0}.
        out: directory for scenario.toml, the recording, and a folder for each arm with its summary.json and
            arrays; None writes no files, unless `recording` is set, which writes to `runs/`.
        recording: whether to write `recording.rrd`, of all arms.

    Raises:
        InputError: the scenario is wrong or asks for what cannot be reached.
        SolverError: the physics could not be solved.
        RunInterrupted: by Ctrl-C.
    """
    started = time.perf_counter()
    checked, kept = several_arms.load_arms(scenario, overrides), kept_parts.KeptParts(on_disk=True)
    directory = Path(out) if out is not None else default_directory(checked.name) if recording else None
    arrays = {name: ResultBuilder(one.recording.frames_per_s) for name, one in checked.arms.items()}
    options = Options(directory, driver.rerun_recorder if recording else None, tell=preparation.log)
    outcomes = driver.execute_arms(
        checked, options, {name: [each] for name, each in arrays.items()}, started, kept
    )
    results = {
        name: arrays[name].result(outcome.summary, None if directory is None else directory / name)
        for name, outcome in outcomes.items()
    }
    for outcome in outcomes.values():
        log_ending(outcome.summary)
        if outcome.error is not None:
            raise_ended(outcome.error, results, directory)
    return results


def log_ending(summary: dict[str, Any]) -> None:
    """Log the warnings of a run, and the phases in which its soft robot was unstable."""
    for line in (
        *summary["warnings"], *branching_lines(summary["branchings"]), *stability_lines(summary["phases"])
    ):  # fmt: skip
        preparation.log(line)


def raise_ended(error: BaseException, result: object, directory: Path | None) -> NoReturn:
    """Raise the error that ended a run.

    Args:
        error: of the run; an interruption by Ctrl-C becomes `RunInterrupted`.
        result: arrays until then; attribute `result` of the error.
        directory: of the run's files; None without files.
    """
    raised = RunInterrupted(*error.args) if isinstance(error, KeyboardInterrupt) else error
    vars(raised)["result"] = result
    if directory is not None:
        raised.add_note(f"the results until then are in {directory}")
    raise raised from error.__cause__ if raised is error else error
