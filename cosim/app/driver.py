"""Runs a scenario, of one arm or several, and completes its files however the run ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar
from uuid import uuid4

from cosim.app.checkpoint import Origin
from cosim.app.output_directory import OutputDirectory
from cosim.app.resuming import read_checkpoint
from cosim.app.run_files import RECORDING, SCENARIO, RunFiles
from cosim.app.run_follower import MakesRecorder, Observer, Options, RunFollower, RunOutcome, Termination
from cosim.base.files import files_read
from cosim.base.kept_parts import KeptParts
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import RecordingTable
from cosim.config.several_arms import ArmsScenario
from cosim.errors import SolverError
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.telemetry.summary import reason_of
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.stepping.several_arms import ArmBatch
    from cosim.stepping.stepped_run import SteppedRun

_Batch = TypeVar("_Batch")


def execute(
    scenario: Scenario, build: Callable[[Scenario], SteppedRun], options: Options, started: float
) -> RunOutcome:
    """Build and run a scenario, or resume it; the files are complete when this returns.

    Args:
        scenario: checked.
        build: makes the simulation.
        options: of the run.
        started: `time.perf_counter()` at the start of the command.

    Raises:
        InputError: the scenario cannot be built, the directory cannot be written, or the checkpoint cannot be
            read; nothing was written.
    """
    with ExitStack() as stack:
        files = None
        if options.directory is not None:
            files = RunFiles(options.directory, resume=options.resume)
            stack.enter_context(files.out)
        with files_read() as read:
            simulation, earlier = build(scenario), None
        if files is not None:
            files.note_loaded(scenario, read)
        if options.resume:
            assert options.directory is not None, "a run is resumed in its directory"
            earlier = read_checkpoint(options.directory, simulation)
        first, batches = _with_first(simulation.batches())
        for watcher in options.watchers:
            watcher.open(simulation.stage)
            stack.callback(watcher.close)
        origin = Origin.of(uuid4().hex, earlier).after(-started)
        follower = RunFollower(scenario, simulation, options, files, origin, first)
        return follower.finish(drive(batches, follower.observe, options.stop, follower.flush))


def execute_arms(
    scenario: ArmsScenario,
    options: Options,
    watchers: Mapping[str, Sequence[Observer]],
    started: float,
    kept: KeptParts,
) -> dict[str, RunOutcome]:
    """Build and run several arms; the files are complete when this returns.

    Args:
        scenario: checked.
        options: without watchers; checkpoints are not written.
        watchers: observe all ticks of an arm, by its name.
        started: `time.perf_counter()` at the start of the command.
        kept: parts that may be used again.

    Raises:
        InputError: the scenario cannot be built, or the directory cannot be written; nothing was written.
        SolverError: an arm has no state at rest at its start; the same.
    """
    from cosim.build.simulation import build_arms  # here: wrong input is refused before engines are loaded

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
        first = list(islice(batches, len(run.runs)))  # wrong input is reported before anything is written
        at_rest = {each.arm: each.batch for each in first}
        if directory is not None:
            top.begin(SCENARIO, scenario.text(), RECORDING)
        recorders = _recorders(scenario, options)
        followers = dict[str, RunFollower]()
        for name, one in scenario.arms.items():
            if name in files:
                files[name].note_loaded(one, read)
            arm_options = replace(
                options, watchers=watchers[name], checkpoint_every_s=None, make_recorder=recorders.get(name),
                several=True,
            )  # fmt: skip
            for watcher in arm_options.watchers:
                watcher.open(run.runs[name].stage)
                stack.callback(watcher.close)
            origin = Origin.of(uuid4().hex, None).after(-started)
            followers[name] = RunFollower(
                one, run.runs[name], arm_options, files.get(name), origin, at_rest[name]
            )

        def observe(ticks: ArmBatch) -> None:
            followers[ticks.arm].observe(ticks.batch)

        def flush() -> None:
            for follower in followers.values():
                follower.flush()

        ending = drive(chain(first, batches), observe, options.stop, flush)
        return {name: follower.finish(ending) for name, follower in followers.items()}


def _recorders(scenario: ArmsScenario, options: Options) -> dict[str, MakesRecorder]:
    """Return a function that makes the recorder of each arm; all write one recording."""
    if options.directory is None or options.make_recorder is None:
        return {}
    settings = next(iter(scenario.arms.values())).recording
    path, part = options.directory / RECORDING, RecordingPart(uuid4().hex)
    each = options.make_recorder(path, settings, part).of_arms(tuple(scenario.arms))
    return {name: partial(_same, recorder) for name, recorder in each.items()}


def _same(recorder: Recorder, *_: object) -> Recorder:
    return recorder


def rerun_recorder(
    path: Path, settings: RecordingTable, part: RecordingPart, viewer: str | None = None
) -> Recorder:
    """Return a recorder that writes a Rerun recording, and shows it in a viewer if an address is given."""
    from cosim.recording.rerun_recorder import RerunRecorder  # here: few runs load Rerun

    return RerunRecorder(path, frames_per_s=settings.frames_per_s, part=part, viewer=viewer)


def drive(
    batches: Iterator[_Batch],
    observe: Callable[[_Batch], None],
    stop: Callable[[], str | None],
    at_end: Callable[[], None] = lambda: None,
) -> Termination:
    """Pass all ticks to an observer, in order, until a stop, an exception or the end.

    Args:
        batches: of ticks.
        observe: called with each batch.
        stop: called after each batch; a returned text, the reason, interrupts the run.
        at_end: called after the last batch.
    """
    try:
        for batch in batches:
            observe(batch)
            reason = stop()
            if reason is not None:
                return Termination("interrupted", reason)
        at_end()  # its time is part of the loop's
    except KeyboardInterrupt as error:
        return Termination("interrupted", "keyboard interrupt", error)
    except Exception as error:  # after any error, recording and summary are completed
        return Termination("failed", reason_of(error), error)
    return Termination("completed")


def _with_first(batches: Iterator[TickBatch]) -> tuple[TickBatch | None, Iterator[TickBatch]]:
    """Return the first ticks, if any, and all ticks; wrong input is reported before anything is written."""
    try:
        first = next(batches, None)
    except SolverError as error:
        return None, map(_raise, [error])  # raised inside the loop, after which the files are completed
    return first, batches if first is None else chain([first], batches)


def _raise(error: SolverError) -> TickBatch:
    raise error
