"""The progress of a run: as a line of text, and as observers that show it."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, final

from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

_REDRAW_S: Final = 0.2
_BAR: Final = 24


class ProgressLine:
    """Updates one line on a terminal; elsewhere writes one line per finished phase.

    Args:
        draw: writes a text without an end of line.
        renews: whether it writes to a terminal.
        started: `time.perf_counter()` at the start of the command; None: when the simulation is built.
    """

    def __init__(self, draw: Callable[[str], object], *, renews: bool, started: float | None = None) -> None:
        self._draw, self._renews, self._commanded = draw, renews, started
        self._stage: RunInfo | None = None
        self._first: Snapshot | None = None
        self._last: Snapshot | None = None
        self._started = self._seen = self._shown = 0.0

    def open(self, stage: RunInfo) -> None:
        """Start the clock; the simulation is built.

        Args:
            stage: of the run.
        """
        self._stage, self._first, self._last = stage, None, None
        self._started = self._seen = self._shown = time.perf_counter()

    def observe(self, batch: TickBatch) -> None:
        """Show the last of some ticks, at most five times a second.

        Args:
            batch: the ticks, in order.
        """
        now, snapshot = time.perf_counter(), batch.snapshot(-1)
        if not self._renews and self._last is not None and snapshot.phase != self._last.phase:
            self._show(end="\n")
        self._first, self._last, self._seen = self._first or snapshot, snapshot, now
        if self._renews and now - self._shown >= _REDRAW_S:
            self._shown = now
            self._show(end="")

    def close(self) -> None:
        """Show the last state of the run."""
        self._show(end="\n")

    @property
    def _erase(self) -> str:
        """Characters that erase the line before."""
        return "\r\x1b[K" if self._renews and self._last is not None else ""

    def _show(self, end: str) -> None:
        if self._stage is None or self._first is None or self._last is None:
            return
        begun = self._started if self._commanded is None else self._commanded
        spent = Spent(self._seen - begun, self._seen - self._started)
        self._write(progress_line(self._stage, self._last, spent, self._first), end)

    def _write(self, line: str, end: str) -> None:
        self._draw(self._erase + line + end)


@final
class ProgressBar(ProgressLine):
    """Shows the progress of a run, for `cosim.run(..., observers=[cosim.ProgressBar()])`.

    In a notebook it updates one line below the cell; elsewhere it writes to standard error: on a terminal it
    updates one line, otherwise it writes a line per phase.
    """

    def __init__(self) -> None:
        super().__init__(_to_stderr, renews=False)
        self._in_notebook: Any = None

    def open(self, stage: RunInfo) -> None:
        """Start the clock; the simulation is built.

        Args:
            stage: of the run.
        """
        super().open(stage)
        self._renews = sys.stderr.isatty()
        if _is_notebook():
            from IPython.display import display  # every notebook has IPython

            self._renews, self._in_notebook = True, display(_as_text("..."), raw=True, display_id=True)

    def _write(self, line: str, end: str) -> None:
        if self._in_notebook is None:
            super()._write(line, end)
        else:
            self._in_notebook.update(_as_text(line), raw=True)


@final
@dataclass(frozen=True)
class Spent:
    """Wall time until now.

    Args:
        command_s: since the start of the command [s].
        loop_s: since the first tick [s].
    """

    command_s: float
    loop_s: float


def progress_line(stage: RunInfo, snapshot: Snapshot, spent: Spent, first: Snapshot) -> str:
    """Return the text of the progress line: progress, speed, and remaining time.

    Args:
        stage: of the run.
        snapshot: the last tick.
        spent: until this tick.
        first: the first tick of this command.
    """
    fraction = snapshot.tick / stage.ticks if stage.ticks else 1.0
    filled = min(_BAR, int(_BAR * fraction))
    factor = (snapshot.time_s - first.time_s) / spent.command_s if spent.command_s > 0.0 else 0.0
    done, to_do = snapshot.tick - first.tick, stage.ticks - snapshot.tick
    left = "..." if not done else f"{clock(spent.loop_s * to_do / done)} left" if to_do else "done"
    bar = "#" * filled + "." * (_BAR - filled)
    return (
        f"[{bar}] {100 * fraction:3.0f} %  {stage.phase_names[snapshot.phase]:<12} "
        f"{snapshot.time_s:.2f}/{stage.duration_s:.2f} s  x{factor:.2f} real time  {left}"
    )


def clock(seconds: float) -> str:
    """Return a duration as minutes:seconds or hours:minutes:seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _is_notebook() -> bool:
    """Return whether this process is a notebook's kernel."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    return hasattr(get_ipython(), "kernel")


def _as_text(line: str) -> dict[str, str]:
    return {"text/plain": line}


def _to_stderr(line: str) -> None:
    print(line, end="", file=sys.stderr, flush=True)
