"""Shows the progress of a sweep in one line."""

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, TextIO, final

from cosim.cli.screen import draw

if TYPE_CHECKING:
    from cosim.sweeps.study_run import SweepProgress

_REDRAW_S: Final = 0.2
_RETOLD_S: Final = 30.0


def counts_text(statuses: Mapping[str, int]) -> str:
    """Return the number of designs of each status, such as "3 completed, 1 failed"."""
    return ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))


@final
class SweepLine:
    """Redraws one line on a terminal; in a file, prints a line every half minute.

    Args:
        stream: for the line, usually stderr.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._terminal = stream, stream.isatty()
        self._every_s = _REDRAW_S if self._terminal else _RETOLD_S
        self._drawn = time.perf_counter()

    def __call__(self, progress: "SweepProgress") -> None:
        """Show the progress of a sweep."""
        now, at_end = time.perf_counter(), progress.done == progress.count
        if now - self._drawn < self._every_s and not at_end:
            return
        self._drawn = now
        start, end = ("\r\x1b[K", "\n" if at_end else "") if self._terminal else ("", "\n")
        draw(f"{start}{sweep_line(progress)}{end}", self._stream)


def sweep_line(progress: "SweepProgress") -> str:
    """Return the progress of a sweep in one line."""
    from cosim.app.progress import clock  # here, because it loads numpy

    left_s = progress.left_s
    left = "" if left_s is None or progress.done == progress.count else f", {clock(left_s)} left"
    return f"{progress.done} of {progress.count} designs: {counts_text(progress.statuses)}{left}"
