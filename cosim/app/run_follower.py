"""Processes the ticks of a run while it lasts, and completes its files at the end, however it ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, final

from cosim._version import __version__
from cosim.app.array_recorder import ArrayRecorder
from cosim.app.checkpoint import CheckpointKeeper, Origin
from cosim.app.run_files import RECORDING, RunFiles
from cosim.base import compile_time
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import RecordingTable
from cosim.errors import SolverError
from cosim.recording.recorder import Recorder, Recorders, RecordingPart
from cosim.telemetry.phase_ends import PhaseEnds
from cosim.telemetry.run_errors import RunErrors
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.summary import Status, SummaryBuilder
from cosim.telemetry.texts.summary_markdown import summary_markdown
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun

Observe: TypeAlias = Callable[[TickBatch], None]
MakesRecorder: TypeAlias = Callable[[Path, RecordingTable, RecordingPart], Recorder]
FindsBars: TypeAlias = Callable[[Scenario, PhaseEnds], RunErrors]


class Observer(Protocol):
    """Observes a run while it lasts."""

    def open(self, stage: RunInfo) -> None:
        """Begin; the simulation is built, and nothing has been written yet.

        Args:
            stage: names, shapes and triangles, which do not change during the run.
        """

    def observe(self, batch: TickBatch) -> None:
        """Process some ticks of one phase.

        Args:
            batch: the ticks, in order; `batch.snapshot(k)` is one of them.
        """

    def close(self) -> None:
        """End; the run is completed, interrupted or failed."""


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
        directory: for the files; None writes none.
        make_recorder: makes the recorder of a file; None for no recording.
        watchers: observe all ticks.
        stop: called after every batch of ticks, about five times a second; a returned text, the reason,
            interrupts the run.
        checkpoint_every_s: wall time between two checkpoints in the directory; None writes none.
        resume: whether to continue the run in the directory from its checkpoint.
        find_bars: computes error bars from the ends of the phases; None: no error bars.
        tell: called with a sentence before something takes long, while arms are built.
        several: whether the run is that of one of several arms.
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
    """Result of a run.

    Args:
        summary: its figures, as in summary.json.
        error: that ended it, if any.
        ends: of its phases.
    """

    summary: dict[str, Any]
    error: BaseException | None
    ends: PhaseEnds


@final
class RunFollower:
    """Processes the ticks of a run: summary, recording, checkpoints, watchers.

    Args:
        scenario: of the run.
        simulation: of the scenario.
        options: of the run.
        files: of the run; None writes none.
        origin: of the run; its start-up time is less `time.perf_counter()` at the start of the command.
        first: its first ticks; None if the first could not be solved.
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
        """Process some ticks."""
        shown = self._summary.observe(batch).shown()  # observers cannot write to the run's arrays
        for observe in self._observers:
            observe(shown)

    def flush(self) -> None:
        """Write the ticks that the recording has gathered."""
        self._recorder.flush()

    def finish(self, ending: Termination) -> RunOutcome:
        """End recording and files, and return the result of the run."""
        wall_s = self._origin.wall_s + time.perf_counter() - self._began
        if self._keeper is not None:
            self._keeper.end(ending.status, ending.error)
        ends = self._summary.state.ends
        if self._files is not None and ends.ends and not self._options.several:
            self._files.write_ends(ends)
        errors: RunErrors | None = RunErrors(reason="they could not be computed")
        try:
            errors = self._error_bars(ends, ending)
        finally:
            figures = self._complete_files(ending, wall_s, errors)
        return RunOutcome(figures, ending.error, ends)

    def _complete_files(self, ending: Termination, wall_s: float, errors: RunErrors | None) -> dict[str, Any]:
        """End the recording, write the summary, and return its figures."""
        figures = self._summary.finish(ending.status, ending.reason, wall_s, errors, compile_time.take_s())
        try:
            if errors is not None and errors.phases:
                self._recorder.mark_errors(errors.phases)
            self._recorder.close(summary_markdown(figures), ending.status)
        finally:
            if self._files is not None:
                self._files.finish(figures)
        return figures

    def _error_bars(self, ends: PhaseEnds, ending: Termination) -> RunErrors | None:
        """Return the error bars, or why there are none; None if none are wanted."""
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
        except SolverError as error:  # the run itself is completed
            return RunErrors(reason=f"they could not be computed: {error}")


def _begin_files(
    scenario: Scenario, options: Options, files: RunFiles | None, part: RecordingPart
) -> Recorder:
    if files is None:
        return Recorders(())
    if options.resume:
        files.resume()
    else:
        files.begin(scenario)
    arrays = ArrayRecorder(files.next_part, scenario.recording.frames_per_s, part)
    if options.make_recorder is None:
        return arrays
    return Recorders((options.make_recorder(files.next_part(RECORDING), scenario.recording, part), arrays))
