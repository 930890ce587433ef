"""Runs a scenario of several arms: one loop, and for each arm the files of a run of its own in a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from cosim.app.api import log_ending, raise_ended
from cosim.app.checkpoint import Origin
from cosim.app.driver import (
    MakesRecorder,
    Observer,
    Options,
    RunFollower,
    RunOutcome,
    drive,
    log,
    prepared,
    rerun_recorder,
)
from cosim.app.run_files import RECORDING, SCENARIO, OutputDirectory, RunFiles, default_directory
from cosim.base.files import cache_directory, files_read
from cosim.base.kept_parts import KeptParts
from cosim.config.several_arms import ArmsScenario, load_arms
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.results.result import ResultBuilder, RunResult
from cosim.telemetry.tick_batch import TickBatch

Watchers = Mapping[str, Sequence[Observer]]


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
            arrays; None writes none unless a recording is asked for, which then goes to `runs/`.
        recording: whether to write `recording.rrd`, of all arms.

    Raises:
        InputError: the scenario is wrong or asks for what cannot be reached.
        SolverError: the physics could not be solved.
        RunInterrupted: by Ctrl-C.
    """
    started = time.perf_counter()
    loaded, kept = load_arms(scenario, overrides), KeptParts(cache_directory())
    checked = prepared_arms(loaded, log, recording=recording, kept=kept)
    directory = Path(out) if out is not None else default_directory(checked.name) if recording else None
    arrays = {name: ResultBuilder(one.recording.frames_per_s) for name, one in checked.arms.items()}
    options = Options(directory, rerun_recorder if recording else None, error=False, tell=log)
    outcomes = execute_arms(checked, options, {name: [each] for name, each in arrays.items()}, started, kept)
    results = {
        name: arrays[name].result(outcome.summary, None if directory is None else directory / name)
        for name, outcome in outcomes.items()
    }
    for name, outcome in outcomes.items():
        log_ending(outcome.summary)
        if outcome.error is not None:
            raise_ended(outcome.error, results, directory)
    return results


def prepared_arms(
    scenario: ArmsScenario, tell: Callable[[str], None], *, recording: bool, kept: KeptParts
) -> ArmsScenario:
    """Return the scenario with each arm's model built, and all compiled that its loop calls."""
    arms = {
        name: prepared(one, tell, recording=recording, contact=True, kept=kept)
        for name, one in scenario.arms.items()
    }
    return replace(scenario, arms=arms)


def execute_arms(
    scenario: ArmsScenario, options: Options, watchers: Watchers, started: float, kept: KeptParts
) -> dict[str, RunOutcome]:
    """Build and run several arms; the files are complete when this returns.

    Args:
        scenario: checked.
        options: without watchers; checkpoints are not written.
        watchers: shown every tick of an arm, by its name.
        started: `time.perf_counter()` at the start of the command.
        kept: parts that may be used again.

    Raises:
        InputError: the scenario cannot be built, or the directory not be written; nothing was written.
        SolverError: an arm finds no rest at its start; the same.
    """
    from cosim.build.simulation import build_arms  # here, so that wrong input needs no engine

    with ExitStack() as stack:
        directory, files = options.directory, dict[str, RunFiles]()
        if directory is not None:
            top = stack.enter_context(OutputDirectory(directory))
            files = {name: RunFiles(directory / name) for name in scenario.arms}
        for each in files.values():
            stack.enter_context(each.out)
        with files_read() as read:
            run = build_arms(scenario.arms, options.tell, kept)
        batches = run.batches()
        first = dict(islice(batches, len(run.runs)))  # wrong input shows before anything is written
        if directory is not None:
            top.begin(SCENARIO, scenario.text(), RECORDING)
        recorders = _recorders(scenario, options)
        followers = dict[str, RunFollower]()
        for name, one in scenario.arms.items():
            if name in files:
                files[name].note_loaded(one, read)
            own = replace(options, watchers=watchers[name], checkpoint_every_s=None, make_recorder=recorders.get(name))
            for watcher in own.watchers:
                watcher.open(run.runs[name].stage)
                stack.callback(watcher.close)
            origin = Origin.of(uuid4().hex, None).after(-started)
            followers[name] = RunFollower(one, run.runs[name], own, files.get(name), origin, first[name])

        def observe(taken: tuple[str, TickBatch]) -> None:
            followers[taken[0]].observe(taken[1])

        def flush() -> None:
            for follower in followers.values():
                follower.flush()

        ending = drive(chain(first.items(), batches), observe, options.stop, flush)
        return {name: follower.finish(ending) for name, follower in followers.items()}


def _recorders(scenario: ArmsScenario, options: Options) -> dict[str, MakesRecorder]:
    """Return what makes the recorder of each arm, all of one recording."""
    if options.directory is None or options.make_recorder is None:
        return {}
    settings = next(iter(scenario.arms.values())).recording
    path, part = options.directory / RECORDING, RecordingPart(uuid4().hex)
    each = options.make_recorder(path, settings, part).of_arms(tuple(scenario.arms))
    return {name: partial(_given, recorder) for name, recorder in each.items()}


def _given(recorder: Recorder, *_: object) -> Recorder:
    return recorder
