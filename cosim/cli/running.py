"""The commands `cosim run` and `cosim warm-up`: run or resume a scenario with a progress line, and return the
exit code.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, final

from cosim.app import driver, preparation, progress, resuming, run_files
from cosim.app.error_bars import bars_finder
from cosim.app.run_follower import Observer, Options, RunOutcome
from cosim.base import kept_parts
from cosim.cli.interruption import Interruption
from cosim.cli.screen import draw, logged_to, tell
from cosim.config import arm_files, loading, rules, several_arms
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.toml.reading import parse_assignment
from cosim.errors import InputError
from cosim.plan.decision import SECTION_RANGE
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.texts.closing_lines import closing_lines, quiet_line
from cosim.telemetry.tick_batch import TickBatch

if TYPE_CHECKING:
    from cosim.cli.viewing import LiveView


@final
class TerminalLine(progress.ProgressLine):
    """The progress line of the command line.

    Args:
        stream: where to draw, usually stderr.
        started: `time.perf_counter()` at the start of the command; None: when the simulation has been built.
    """

    def __init__(self, stream: TextIO, started: float | None = None) -> None:
        super().__init__(partial(draw, stream=stream), renews=stream.isatty(), started=started)
        self._stream = stream

    def tell(self, text: str) -> None:
        """Print a line above the progress line, which is drawn again at the next ticks."""
        draw(self._erase, self._stream)
        tell(text, self._stream)


@final
class PlanWarnings:
    """Warns before a run of rounded phases, exceeded bounds of the arm, or a section model's range.

    Args:
        stream: for the warnings, usually stderr.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def open(self, stage: RunInfo) -> None:
        """Print the warnings."""
        for line in (*stage.rounded, *(() if stage.arm is None else stage.arm.warnings())):
            tell(f"warning: {line}", self._stream)
        for decision in stage.modelled:
            if decision.what == SECTION_RANGE and not decision.included:
                tell(f"warning: {decision.line}", self._stream)

    def observe(self, batch: TickBatch) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


@final
@dataclass(frozen=True)
class RunOptions:
    """Options of a run.

    Args:
        recording: whether to write a recording.
        quiet: whether to print only errors, and one line at the end.
        checkpoint_every_s: wall time between two checkpoints; None for the default.
        live: viewer of the run while it is simulated, or None.
        watchers: further observers of every tick.
        error: whether to compute error bars; None: if they cost little.
        started: `time.perf_counter()` at the start of the command.
    """

    recording: bool
    quiet: bool
    checkpoint_every_s: float | None
    started: float
    live: LiveView | None = None
    watchers: tuple[Observer, ...] = ()
    error: bool | None = None


def run_command(scenario_name: str, assignments: Sequence[str], out: Path | None, how: RunOptions) -> int:
    """Run a scenario and return the exit code.

    Args:
        scenario_name: name or path.
        assignments: texts of the form key=value.
        out: directory of the results; None for a new one under runs/.
        how: options of the run.

    Raises:
        InputError: the scenario or directory is wrong; nothing was written.
        SolverError: the physics could not be solved; the results so far are written.
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
    """Print the title of a scenario, and the assumed limits of its arms."""
    arms = [robot for robot in dict.fromkeys(robots) if robot != NO_ARM]
    for line in (title, *(line for arm in arms for line in arm_files.assumed_limits(arm))):
        tell(line)


def warm_up_command(names: Sequence[str]) -> int:
    """Compile kernels, build the section models of scenarios, and return the exit code.

    Args:
        names: names or paths of scenarios.

    Raises:
        InputError: a scenario is wrong; those before it are ready.
    """
    preparation.warm_up()
    for name in names:
        kept = kept_parts.KeptParts(on_disk=True)
        if several_arms.has_arms(name):
            for arm, scenario in several_arms.load_arms(name).arms.items():
                with several_arms.of_arm(arm):
                    preparation.build_section_model(scenario, tell, kept)
        else:
            preparation.build_section_model(loading.load_scenario(name), tell, kept)
        tell(f"{name}: ready to run")
    return 0


def _run_arms(scenario: several_arms.ArmsScenario, out: Path | None, how: RunOptions) -> int:
    """Run several arms and return the exit code; the progress line is that of the first arm."""
    if how.error:
        raise InputError("--error: several arms have no error bars; leave it out, or run each arm alone")
    if how.checkpoint_every_s is not None:
        raise InputError("--checkpoint-every: several arms write no checkpoints; leave it out")
    directory = out if out is not None else run_files.default_directory(scenario.name)
    run_files.check_directory(directory)
    line, kept = TerminalLine(sys.stderr, how.started), kept_parts.KeptParts(on_disk=True)
    if not how.quiet:
        _tell_begin(scenario.title, [arm.robot for arm in scenario.arms.values()])
    report = _ignore if how.quiet else line.tell
    with logged_to(report), Interruption() as interruption:
        watchers: dict[str, list[Observer]] = {
            name: [] if how.quiet else [PlanWarnings(sys.stderr)] for name in scenario.arms
        }
        next(iter(watchers.values())).extend([interruption, *how.watchers, *([] if how.quiet else [line])])
        recorder = driver.rerun_recorder if how.live is None else how.live.recorder
        options = Options(
            directory, recorder if how.recording else None, stop=interruption.reason, tell=report
        )
        try:
            outcomes = driver.execute_arms(scenario, options, watchers, how.started, kept)
        except KeyboardInterrupt:  # before the loop: nothing is lost
            tell("cosim: interrupted")
            return interruption.exit_code
    return _report_arms(outcomes, directory, interruption, quiet=how.quiet)


def _report_arms(
    outcomes: Mapping[str, RunOutcome], directory: Path, interruption: Interruption, *, quiet: bool
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
    """Resume an interrupted run and return the exit code; it is recorded if it was recorded before.

    Args:
        directory: of the run.
        how: options of the run.

    Raises:
        InputError: the run cannot continue; nothing was written.
        SolverError: the physics could not be solved; the results so far are written.
    """
    resuming.check_resumable(directory)
    scenario = loading.load_scenario(directory / run_files.SCENARIO)
    tick = resuming.tick_to_resume(directory, scenario)
    if not how.quiet:
        tell(f"{scenario.title}: resumes after tick {tick}")
    recording = how.recording and bool(run_files.recordings(directory))
    return _execute(scenario, directory, replace(how, recording=recording), resume=True)


def _execute(scenario: Scenario, directory: Path, how: RunOptions, *, resume: bool) -> int:
    line = TerminalLine(sys.stderr, how.started)
    report = _ignore if how.quiet else line.tell
    kept = kept_parts.KeptParts(on_disk=True)
    with logged_to(report), Interruption() as interruption:
        shown: list[Observer] = [] if how.quiet else [PlanWarnings(sys.stderr), line]
        watchers: list[Observer] = [interruption, *how.watchers, *shown]
        recorder = driver.rerun_recorder if how.live is None else how.live.recorder
        make_recorder = recorder if how.recording else None
        every_s = how.checkpoint_every_s or Options.checkpoint_every_s
        find_bars = bars_finder(how.error, report, kept)
        options = Options(directory, make_recorder, watchers, interruption.reason, every_s, resume, find_bars)
        try:
            outcome = driver.execute(
                scenario, partial(preparation.build_simulation, tell=report, kept=kept), options, how.started
            )
        except KeyboardInterrupt:  # before the loop: nothing is lost
            tell("cosim: interrupted")
            return interruption.exit_code
    return _report(outcome, directory, interruption, quiet=how.quiet)


def _ignore(_text: str) -> None:
    """Print nothing."""


def _report(outcome: RunOutcome, directory: Path, interruption: Interruption, *, quiet: bool) -> int:
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
