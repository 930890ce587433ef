"""`cosim run` and `cosim twin`: from the command line's words to an exit code, with a progress line."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, TextIO, final
from uuid import uuid4

import numpy as np

from cosim.app import checkpoint, driver, progress, run_files
from cosim.base import kept_parts
from cosim.cli.screen import Interruption, draw, logged_to, tell
from cosim.config import arm_files, loading, rules, several_arms
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.settings import RecordingTable
from cosim.config.toml.reading import parse_assignment
from cosim.errors import InputError
from cosim.plan.decision import SECTION_RANGE
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.summary import closing_lines, quiet_line
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.app.twin import Followed, Prediction
    from cosim.cli.viewing import LiveView

_REDRAW_S: Final = 0.2
_RETOLD_S: Final = 1.0


@final
class TerminalLine(progress.ProgressLine):
    """The progress line of the command line.

    Args:
        stream: where to draw, usually stderr.
    """

    def __init__(self, stream: TextIO) -> None:
        super().__init__(partial(draw, stream=stream), renews=stream.isatty())
        self._stream = stream

    def tell(self, text: str) -> None:
        """Print a line above the one that renews itself, which comes back with the next ticks."""
        draw(self._start, self._stream)
        tell(text, self._stream)


@final
class PlanWarnings:
    """Says before a run begins where its plan goes beyond the arm's bounds, or a section model's range.

    Args:
        stream: where to, usually stderr.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def open(self, stage: RunInfo) -> None:
        """Say it, one line each."""
        for line in () if stage.arm is None else stage.arm.warnings():
            tell(f"warning: {line}", self._stream)
        for decision in stage.modelled:
            if decision.what == SECTION_RANGE and not decision.included:
                tell(f"warning: {decision.line}", self._stream)

    def observe(self, batch: TickBatch) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to do."""


@final
@dataclass(frozen=True)
class RunOptions:
    """How a run is done.

    Args:
        recording: whether to write one.
        quiet: show errors, and one line at the end.
        checkpoint_every_s: wall time between two checkpoints; None: the usual.
        live: shows the run while it lasts; None: nothing does.
        watchers: shown every tick, besides those on the screen.
        error: whether to work out how far the figures may be off; None: where it costs little.
        started: `time.perf_counter()` at the start of the command.
    """

    recording: bool
    quiet: bool
    checkpoint_every_s: float | None
    started: float
    live: LiveView | None = None
    watchers: tuple[driver.Observer, ...] = ()
    error: bool | None = None


def run_command(scenario_name: str, assignments: Sequence[str], out: Path | None, how: RunOptions) -> int:
    """Run a scenario and return the exit code.

    Args:
        scenario_name: name or path.
        assignments: texts of the form key=value.
        out: directory of the results; None: under runs/.
        how: see there.

    Raises:
        InputError: the scenario or directory is wrong; nothing was written.
        SolverError: the physics could not be solved; the files say how far it came.
    """
    overrides = dict(map(parse_assignment, assignments))
    if several_arms.has_arms(scenario_name):
        return _run_arms(several_arms.load_arms(scenario_name, overrides), out, how)
    scenario = loading.load_scenario(scenario_name, overrides)
    rules.check_ends(scenario)
    directory = out if out is not None else run_files.default_directory(scenario.name)
    run_files.check_directory(directory)
    if not how.quiet:
        _tell_begin(scenario.title, [scenario.robot])
    return _execute(scenario, directory, how, resume=False)


def _tell_begin(title: str, robots: Sequence[str]) -> None:
    """Print what is run, and which limits of its arms are assumed."""
    arms = [robot for robot in dict.fromkeys(robots) if robot != NO_ARM]
    for line in (title, *(line for arm in arms for line in arm_files.assumed_limits(arm))):
        tell(line)


def warm_up_command(names: Sequence[str]) -> int:
    """Compile kernels, build the section models that scenarios ask for, and return the exit code.

    Args:
        names: of scenarios, or paths.

    Raises:
        InputError: a scenario is wrong; those before it are done.
    """
    driver.warm_up()
    for name in names:
        kept = kept_parts.KeptParts(on_disk=True)
        if several_arms.has_arms(name):
            driver.prepared_arms(several_arms.load_arms(name), tell, kept=kept)
        else:
            driver.prepared(loading.load_scenario(name), tell, kept=kept)
        tell(f"{name}: ready to run")
    return 0


def _run_arms(scenario: several_arms.ArmsScenario, out: Path | None, how: RunOptions) -> int:
    """Run several arms and return the exit code; the progress line is that of the first."""
    if how.error:
        raise InputError("--error: several arms have no error bars; leave it out, or run each arm alone")
    if how.checkpoint_every_s is not None:
        raise InputError("--checkpoint-every: several arms write no checkpoints; leave it out")
    directory = out if out is not None else run_files.default_directory(scenario.name)
    run_files.check_directory(directory)
    line, kept = TerminalLine(sys.stderr), kept_parts.KeptParts(on_disk=True)
    if not how.quiet:
        _tell_begin(scenario.title, [arm.robot for arm in scenario.arms.values()])
    told = _ignore if how.quiet else line.tell
    with logged_to(told):
        scenario = driver.prepared_arms(scenario, told, kept=kept)
    with logged_to(told), Interruption() as interruption:
        watchers: dict[str, list[driver.Observer]] = {
            name: [] if how.quiet else [PlanWarnings(sys.stderr)] for name in scenario.arms
        }
        next(iter(watchers.values())).extend([interruption, *how.watchers, *([] if how.quiet else [line])])
        recorder = driver.rerun_recorder if how.live is None else how.live.recorder
        options = driver.Options(
            directory, recorder if how.recording else None, stop=interruption.reason, tell=told
        )
        try:
            outcomes = driver.execute_arms(scenario, options, watchers, how.started, kept)
        except KeyboardInterrupt:  # before the loop: nothing is lost
            tell("cosim: interrupted")
            return interruption.exit_code
    return _report_arms(outcomes, directory, interruption, quiet=how.quiet)


def _report_arms(
    outcomes: Mapping[str, driver.RunOutcome], directory: Path, interruption: Interruption, *, quiet: bool
) -> int:
    for name, outcome in outcomes.items():
        if quiet:
            tell(quiet_line(outcome.summary, directory / name))
        else:
            tell("\n".join([f"{name}:", *closing_lines(outcome.summary, directory / name, ())]))
    if not quiet and run_files.recordings(directory):
        tell(f"{directory}: {run_files.RECORDING} shows all arms; open it: cosim view {directory}")
    last = outcomes[name]
    if last.summary["status"] == "interrupted":
        tell(f"cosim: interrupted; results are in {directory}; several arms cannot resume: start them again")
        return interruption.exit_code
    if last.error is not None:
        tell(f"cosim: what was simulated is in {directory}")
        raise last.error
    return 0


def resume_command(directory: Path, how: RunOptions) -> int:
    """Go on with an interrupted run and return the exit code; it is recorded if it was before.

    Args:
        directory: of the run.
        how: see there.

    Raises:
        InputError: the run cannot continue; nothing was written.
        SolverError: the physics could not be solved; the files say how far it came.
    """
    checkpoint.check_resumable(directory)
    scenario = loading.load_scenario(directory / run_files.SCENARIO)
    tick = checkpoint.tick_to_resume(directory, scenario)
    if not how.quiet:
        tell(f"{scenario.title}: resumes after tick {tick}")
    recording = how.recording and bool(run_files.recordings(directory))
    return _execute(scenario, directory, replace(how, recording=recording), resume=True)


def _execute(scenario: Scenario, directory: Path, how: RunOptions, *, resume: bool) -> int:
    line = TerminalLine(sys.stderr)
    told = _ignore if how.quiet else line.tell
    kept = kept_parts.KeptParts(on_disk=True)
    with logged_to(told):
        scenario = driver.prepared(scenario, told, kept=kept)
    with logged_to(told), Interruption() as interruption:
        shown: list[driver.Observer] = [] if how.quiet else [PlanWarnings(sys.stderr), line]
        watchers: list[driver.Observer] = [interruption, *how.watchers, *shown]
        recorder = driver.rerun_recorder if how.live is None else how.live.recorder
        make_recorder = recorder if how.recording else None
        every_s = how.checkpoint_every_s or driver.Options.checkpoint_every_s
        options = driver.Options(
            directory, make_recorder, watchers, interruption.reason, every_s, resume, how.error, told, kept
        )
        try:
            outcome = driver.execute(
                scenario, partial(driver.build_simulation, tell=told, kept=kept), options, how.started
            )
        except KeyboardInterrupt:  # before the loop: nothing is lost
            tell("cosim: interrupted")
            return interruption.exit_code
    return _report(outcome, directory, interruption, quiet=how.quiet)


def _ignore(_text: str) -> None:
    """Say nothing."""


def _report(outcome: driver.RunOutcome, directory: Path, interruption: Interruption, *, quiet: bool) -> int:
    summary = outcome.summary
    if not quiet:
        tell("\n".join(closing_lines(summary, directory, run_files.recordings(directory))))
    if summary["status"] == "interrupted":
        tell(f"cosim: interrupted; results are in {directory}; resume it: cosim run --resume {directory}")
        return interruption.exit_code
    if outcome.error is not None:
        tell(f"cosim: what was simulated is in {directory}")
        raise outcome.error
    if quiet:
        tell(quiet_line(summary, directory))
    return 0


def twin_command(
    simulation: Followed,
    streams: Sequence[str],
    settings: RecordingTable,
    out: Path | None,
    live: LiveView | None,
) -> int:
    """Follow a robot until its streams end, or Ctrl-C; return the exit code.

    Args:
        simulation: that follows.
        streams: see `open_stream`.
        settings: of a recording.
        out: file of the recording; None: none.
        live: shows what is predicted; None: the line on the screen alone.

    Raises:
        InputError: a stream is wrong.
        SolverError: the physics could not be solved.
    """
    from cosim.app.twin import Twin  # here: `cosim run` follows no robot

    with ExitStack() as stack, Interruption() as interruption:
        twin = stack.enter_context(Twin(simulation, streams))
        show: list[Callable[[Prediction], None]] = [_line()]
        if live is not None or out is not None:
            path = out or Path(stack.enter_context(TemporaryDirectory())) / run_files.RECORDING
            make = driver.rerun_recorder if live is None else live.recorder
            recorder = make(path, settings, RecordingPart(uuid4().hex))
            recorder.open(simulation.stage)
            stack.callback(lambda: recorder.close(repr(twin), "completed"))
            show.append(_recorded(recorder))
        interruption.open(simulation.stage)
        noted: frozenset[str] = frozenset()
        try:
            for prediction in twin:
                noted = _tell_new(twin.notes, noted)
                for each in show:
                    each(prediction)
                if interruption.reason() is not None:
                    break
        finally:
            draw("\n" * sys.stderr.isatty(), sys.stderr)
            tell(repr(twin))
    return 0


def _tell_new(notes: Mapping[str, int], noted: frozenset[str]) -> frozenset[str]:
    """Print what has not been noted yet, and return all that has been."""
    for text in notes.keys() - noted:
        tell(f"twin: {text}")
    return frozenset(notes)


def _recorded(recorder: Recorder) -> Callable[[Prediction], None]:
    return lambda prediction: recorder.record(prediction.snapshot.table)


def prediction_line(seen: Prediction) -> str:
    """Return the line on the screen: time of the robot, tip, sag, wrench on the flange, latency."""
    snapshot = seen.snapshot
    tip = ", ".join(f"{1e3 * value:.1f}" for value in snapshot.tip_position)
    wrench = snapshot.flange_wrench
    force, torque = np.linalg.norm(wrench.force), np.linalg.norm(wrench.torque)
    return (
        f"{seen.time_s:.2f} s  tip ({tip}) mm  sag {1e3 * snapshot.sag_m:.1f} mm  flange {force:.2f} N "
        f"{torque:.3f} N m  latency {1e3 * seen.latency_s:.1f} ms"
    )


def _line() -> Callable[[Prediction], None]:
    """Return what draws the line, again and again on a terminal, once a second elsewhere."""
    terminal = sys.stderr.isatty()
    start, end, every_s = ("\r\x1b[K", "", _REDRAW_S) if terminal else ("", "\n", _RETOLD_S)
    shown = [0.0]

    def show(prediction: Prediction) -> None:
        now = time.perf_counter()
        if now - shown[0] >= every_s:
            shown[0] = now
            draw(f"{start}{prediction_line(prediction)}{end}", sys.stderr)

    return show
