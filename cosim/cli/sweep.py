"""`cosim sweep`: the designs of a study, run and gathered in one table."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, TextIO, final

from cosim.app.progress import clock
from cosim.base.resources import writing
from cosim.cli.screen import draw, tell
from cosim.sweeps.sweeping import SweepOutcome, SweepProgress, sweep
from cosim.sweeps.table import TABLE, plot_sweep

PLOT: Final = "sweep.png"
_REASONS: Final = 3
"""That are told; all are in the table."""
_REDRAW_S: Final = 0.2
_RETOLD_S: Final = 30.0


def sweep_command(options: argparse.Namespace) -> int:
    """Run a study and return the exit code: 1 if none of its designs is completed.

    Args:
        options: of the command line.

    Raises:
        InputError: study, directory, engine or column is wrong.
        OutputError: the results cannot be written.
    """
    given = {key: vars(options)[key] for key in ("out", "engine", "workers", "modules")}
    try:
        outcome = sweep(options.study, tell=None if options.quiet else SweepLine(sys.stderr), **given)
    except KeyboardInterrupt:
        tell("cosim: interrupted; the rows so far are kept: the same command goes on")
        raise
    if not options.quiet:
        tell(_closing_lines(outcome))
    if options.columns:
        _draw(outcome.directory, options.columns)
    return 0 if outcome.statuses.get("completed") else 1


def _draw(directory: Path, columns: Sequence[str]) -> None:
    path = directory / PLOT
    with writing(path):
        plot_sweep(directory, *columns).savefig(path, dpi=110)
    tell(f"plot:  {path}")


def _closing_lines(outcome: SweepOutcome) -> str:
    lines = [
        f"{outcome.count} designs: {_counts(outcome.statuses)}; {outcome.computed} computed, "
        f"{outcome.reused} known before",
        *(f"{count} times: {reason}" for reason, count in list(outcome.reasons.items())[:_REASONS]),
        f"table: {outcome.directory / TABLE}",
    ]
    return "\n".join(lines)


def _counts(statuses: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))


@final
class SweepLine:
    """Draws one line that renews itself on a terminal; elsewhere a line now and then.

    Args:
        stream: where to draw, usually stderr.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._terminal = stream, stream.isatty()
        self._every_s = _REDRAW_S if self._terminal else _RETOLD_S
        self._drawn = time.perf_counter()

    def __call__(self, progress: SweepProgress) -> None:
        """Show how far a sweep is."""
        now, at_end = time.perf_counter(), progress.done == progress.count
        if now - self._drawn < self._every_s and not at_end:
            return
        self._drawn = now
        start, end = ("\r\x1b[K", "\n" if at_end else "") if self._terminal else ("", "\n")
        draw(f"{start}{sweep_line(progress)}{end}", self._stream)


def sweep_line(progress: SweepProgress) -> str:
    """Return how far a sweep is, in one line."""
    left_s = progress.left_s
    left = "" if left_s is None or progress.done == progress.count else f", {clock(left_s)} left"
    return f"{progress.done} of {progress.count} designs: {_counts(progress.statuses)}{left}"
