"""Ends a run in order when the user presses Ctrl-C, on SIGTERM, or on SIGHUP of a terminal that has been
closed.
"""

import signal
from types import FrameType, TracebackType
from typing import Any, final

from cosim.base.platform import HANG_UP
from cosim.telemetry import run_info, tick_batch


@final
class Interruption:
    """A context manager for signals: the first one stops the run after a tick, a second one stops it at once.

    Before the loop of ticks there is nothing to save, so the first signal raises KeyboardInterrupt as well.
    SIGHUP is ignored if it is ignored when the program starts (`nohup`). A second SIGHUP is ignored, as shell
    and terminal may each send one.
    """

    def __init__(self) -> None:
        self.signal_number: int | None = None
        self._running = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> "Interruption":
        hang_up = [] if HANG_UP is None or signal.getsignal(HANG_UP) == signal.SIG_IGN else [HANG_UP]
        for number in (signal.SIGINT, signal.SIGTERM, *hang_up):
            self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @property
    def exit_code(self) -> int:
        """128 plus the number of the signal, as in shells."""
        return 128 + (self.signal_number or signal.SIGINT)

    def reason(self) -> str | None:
        """Return why the loop should stop, or None."""
        return None if self.signal_number is None else signal.Signals(self.signal_number).name

    def open(self, stage: run_info.RunInfo) -> None:
        """Mark the beginning of the loop, after which there is something to save."""
        self._running = True

    def observe(self, batch: tick_batch.TickBatch) -> None:
        """Do nothing; the loop calls `reason` after every batch."""

    def close(self) -> None:
        """Do nothing, as the files are still being closed."""

    def _handle(self, number: int, frame: FrameType | None) -> None:
        repeated = self.signal_number is not None
        if repeated and number == HANG_UP:
            return
        self.signal_number = number
        if repeated or not self._running:
            raise KeyboardInterrupt
