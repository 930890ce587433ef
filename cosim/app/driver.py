"""Runs a scenario: feeds its ticks to whatever follows it, and ends files in good order whatever happens."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, final
from uuid import uuid4

from cosim._version import __version__
from cosim.app.array_recorder import ArrayRecorder
from cosim.app.checkpoint import CheckpointKeeper, Origin, read_checkpoint
from cosim.app.output_directory import OutputDirectory
from cosim.app.run_files import RECORDING, SCENARIO, RunFiles
from cosim.base.files import files_read
from cosim.base.kept_parts import KeptParts
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import RecordingTable
from cosim.config.several_arms import ArmsScenario
from cosim.errors import SolverError
from cosim.recording.recorder import Recorder, Recorders, RecordingPart
from cosim.telemetry.phase_ends import PhaseEnds
from cosim.telemetry.run_errors import RunErrors
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.summary import Status, SummaryBuilder, reason_of, summary_markdown
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun


class Observer(Protocol):
    """What follows a run while it lasts."""

    def open(self, stage: RunInfo) -> None:
        """The simulation is built; nothing has been written yet.

        Args:
            stage: names, shapes and triangles, of which nothing changes while the run lasts.
        """

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks of one phase.

        Args:
            batch: the ticks, in order; `batch.snapshot(k)` shows one of them.
        """

    def close(self) -> None:
        """The run has ended, one way or another."""


Observe = Callable[[TickBatch], None]
MakesRecorder = Callable[[Path, RecordingTable, RecordingPart], Recorder]
FindsBars = Callable[[Scenario, PhaseEnds], RunErrors]
Some = TypeVar("Some")


@final
@dataclass(frozen=True)
class Termination:
    """How a run ended; `error` is None unless something was raised."""

    status: Status
    reason: str | None = None
    error: BaseException | None = None


@final
@dataclass(frozen=True)
class Options:
    """How a scenario is run.

    Args:
        directory: where the files go; None writes none.
        make_recorder: makes the recorder of a file; None for no recording.
        watchers: shown every tick.
        stop: asked after every batch of ticks, of some 0.2 s; a text interrupts the run, and says why.
        checkpoint_every_s: wall time between two checkpoints in the directory; None: there are none.
        resume: whether to continue with the run in the directory, from its checkpoint.
        find_bars: works out how far the figures may be off, from the ends of the phases; None: nobody does.
        tell: told what takes long while arms are built.
        several: whether it is one of several arms.
    """

    directory: Path | None = None
    make_recorder: MakesRecorder | None = None
    watchers: Sequence[Observer] = ()
    stop: Callable[[], str | None] = lambda: None
    checkpoint_every_s: float | None = 30.0
    resume: bool = False
    find_bars: FindsBars | None = None
    tell: Callable[[str], None] = lambda _text: None
    several: bool = False


@final
@dataclass(frozen=True)
class RunOutcome:
    """What is left of a run.

    Args:
        summary: its figures, as in summary.json.
        error: that ended it, if one did.
        ends: of its phases.
    """

    summary: dict[str, Any]
    error: BaseException | None
    ends: PhaseEnds


def execute(
    scenario: Scenario, build: Callable[[Scenario], SteppedRun], options: Options, started: float
) -> RunOutcome:
    """Build and run a scenario, or the rest of it; the files are complete when this returns.

    Args:
        scenario: checked.
        build: makes the simulation.
        options: see there.
        started: `time.perf_counter()` at the start of the command.

    Raises:
        InputError: the scenario cannot be built, the directory not be written, or the checkpoint not be read;
            nothing was written.
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
            earlier = read_checkpoint(options.directory, simulation, simulation.stage)
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
            own = replace(
                options, watchers=watchers[name], checkpoint_every_s=None, make_recorder=recorders.get(name),
                several=True,
            )  # fmt: skip
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


@final
class RunFollower:
    """Takes in the ticks of a run: sums them up, records them, keeps checkpoints, and shows them to watchers.

    Args:
        scenario: of the run.
        simulation: built.
        options: see there.
        files: of the run; None writes none.
        origin: of the run, with the time of its start counted from `time.perf_counter()` at the command's.
        first: its first ticks, if they are known.
    """

    def __init__(
        self,
        scenario: Scenario,
        simulation: SteppedRun,
        options: Options,
        files: RunFiles | None,
        origin: Origin,
        first: TickBatch | None,
    ) -> None:
        self._scenario, self._files, self._options, stage = scenario, files, options, simulation.stage
        self._recorder = recorder = _begin_files(
            scenario, options, files, RecordingPart(origin.run_id, origin.before)
        )
        recorder.open(stage)
        if first is not None:
            recorder.lay_out(first.snapshot(0))
        self._began = time.perf_counter()
        self._origin = origin = origin.after(self._began)
        self._summary = SummaryBuilder(stage, origin.startup_s, __version__, origin.resumed_at_ticks)
        if origin.checkpoint is not None:
            self._summary.state = origin.checkpoint.summary
        self._observers: list[Observe] = [recorder.record]
        self._keeper, every_s = None, options.checkpoint_every_s
        if files is not None and every_s is not None:
            keeper = CheckpointKeeper(simulation, self._summary, origin, files, every_s, recorder.flush)
            self._keeper, self._observers = keeper, [keeper.observe, recorder.record, keeper.write_when_due]
        self._observers += [watcher.observe for watcher in options.watchers]

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        shown = self._summary.observe(batch).shown()  # observers are others, whatever they do
        for observe in self._observers:
            observe(shown)

    def flush(self) -> None:
        """Bring to the disk what the recording still gathers."""
        self._recorder.flush()

    def finish(self, ending: Termination) -> RunOutcome:
        """End recording and files, and return what is left of the run."""
        wall_s = self._origin.wall_s + time.perf_counter() - self._began
        if self._keeper is not None:
            self._keeper.end(ending.status, ending.error)
        ends = self._summary.state.ends
        if self._files is not None and ends.ends and not self._options.several:
            self._files.write_ends(ends)
        errors = self._error_bars(ends, ending)
        figures = self._summary.finish(ending.status, ending.reason, wall_s, errors)
        try:
            if errors is not None and errors.phases:
                self._recorder.mark_errors(errors.phases)
            self._recorder.close(summary_markdown(figures), ending.status)
        finally:
            if self._files is not None:
                self._files.finish(figures)
        return RunOutcome(figures, ending.error, ends)

    def _error_bars(self, ends: PhaseEnds, ending: Termination) -> RunErrors | None:
        """Return how far the figures may be off; None: that was not asked for."""
        options = self._options
        if options.several:
            return RunErrors(reason="error bars are known for runs of one arm only")
        if options.find_bars is None:
            return None
        if ending.status != "completed":
            return RunErrors(reason="the run did not complete")
        try:
            return options.find_bars(self._scenario, ends)
        except KeyboardInterrupt:
            return RunErrors(reason="it was interrupted")


def _begin_files(
    scenario: Scenario, options: Options, files: RunFiles | None, part: RecordingPart
) -> Recorder:
    if files is None:
        return Recorders(())
    if options.resume:
        files.go_on()
    else:
        files.begin(scenario)
    arrays = ArrayRecorder(files.next_part, scenario.recording.frames_per_s, part)
    if options.make_recorder is None:
        return arrays
    return Recorders((options.make_recorder(files.next_part(RECORDING), scenario.recording, part), arrays))


def rerun_recorder(
    path: Path, settings: RecordingTable, part: RecordingPart, viewer: str | None = None
) -> Recorder:
    """Return the recorder that writes a Rerun recording, and shows it in a viewer at an address."""
    from cosim.recording.rerun_recorder import RerunRecorder

    return RerunRecorder(path, frames_per_s=settings.frames_per_s, part=part, viewer=viewer)


def drive(
    batches: Iterator[Some],
    observe: Callable[[Some], None],
    stop: Callable[[], str | None],
    at_end: Callable[[], None] = lambda: None,
) -> Termination:
    """Feed all ticks to an observer, in order, until a stop, an exception or the end (`at_end`)."""
    try:
        for batch in batches:
            observe(batch)
            reason = stop()
            if reason is not None:
                return Termination("interrupted", reason)
        at_end()  # what observers still gather belongs to the time of the loop
    except KeyboardInterrupt as error:
        return Termination("interrupted", "keyboard interrupt", error)
    except Exception as error:  # whatever it is, the recording and the summary are to be readable
        return Termination("failed", reason_of(error), error)
    return Termination("completed")


def _with_first(batches: Iterator[TickBatch]) -> tuple[TickBatch | None, Iterator[TickBatch]]:
    """Return the first ticks, if any, computed now: wrong input shows before anything is written; and all."""
    try:
        first = next(batches, None)
    except SolverError as error:
        return None, map(_raise, [error])  # raised inside the loop, which writes what is known
    return first, batches if first is None else chain([first], batches)


def _raise(error: SolverError) -> TickBatch:
    raise error
