"""The progress line: phase, simulated time, real-time factor, time left."""

from __future__ import annotations

import time
from typing import TextIO, final

from cosim.app.progress import progress_line
from cosim.cli.screen import draw, tell
from cosim.plan.decision import SECTION_RANGE
from cosim.telemetry.snapshot import RunInfo, Snapshot
from cosim.telemetry.tick_batch import TickBatch

_REDRAW_S = 0.2


@final
class ProgressLine:
    """Draws one line that renews itself on a terminal; elsewhere one line per finished phase.

    Args:
        stream: where to draw, usually stderr.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._terminal = stream.isatty()
        self._stage: RunInfo | None = None
        self._last: Snapshot | None = None
        self._first: Snapshot | None = None
        self._started = self._drawn = 0.0

    def open(self, stage: RunInfo) -> None:
        """Start the clock."""
        self._stage = stage
        self._started = self._drawn = time.perf_counter()

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks; draw at most five times a second."""
        now, snapshot = time.perf_counter(), batch.snapshot(-1)
        if not self._terminal and self._last is not None and snapshot.phase != self._last.phase:
            self._write(self._last, now, "\n")
        self._first, self._last = self._first or snapshot, snapshot
        if self._terminal and now - self._drawn >= _REDRAW_S:
            self._drawn = now
            self._write(snapshot, now, "")

    def close(self) -> None:
        """Draw the last state and leave the line."""
        if self._last is not None:
            self._write(self._last, time.perf_counter(), "\n")

    def tell(self, text: str) -> None:
        """Print a line above the one that renews itself, which comes back with the next ticks."""
        draw("\r\x1b[K" if self._terminal and self._last is not None else "", self._stream)
        tell(text, self._stream)

    def _write(self, snapshot: Snapshot, now: float, end: str) -> None:
        if self._stage is None or self._first is None:
            return
        line = progress_line(self._stage, snapshot, now - self._started, self._first)
        start = "\r\x1b[K" if self._terminal else ""
        draw(start + line + end, self._stream)


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
