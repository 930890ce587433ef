"""What the command line prints, and how Ctrl-C and other signals end a run in good order.

Ends a run in good order on Ctrl-C, SIGTERM, or SIGHUP of a terminal that has been closed.
"""

import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any, TextIO, final

from cosim.telemetry import snapshot, tick_batch

_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with control characters, but tabs and line breaks, as their escape sequences."""
    return _STEERING.sub(lambda found: found.group().encode("unicode_escape").decode("ascii"), text)


def tell(text: str, stream: TextIO | None = None) -> None:
    """Print a text as a line, on stderr unless another stream is given; do nothing where nobody reads it."""
    draw(printable(text) + "\n", stream or sys.stderr)


def draw(text: str, stream: TextIO) -> None:
    """Write a text as it is; a run continues when only the screen is gone."""
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError):
        mute(stream)


def mute(stream: TextIO) -> None:
    """Let a stream that cannot be written to swallow what it still holds, and all that comes."""
    with suppress(OSError, ValueError):
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, stream.fileno())
        os.close(sink)


def open_missing_streams() -> None:
    """Give a process that was started without standard streams some that swallow everything."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  # for good


@final
class _Told(logging.Handler):
    def __init__(self, told: Callable[[str], None]) -> None:
        super().__init__()
        self._told = told

    def emit(self, record: logging.LogRecord) -> None:
        (tell if record.levelno >= logging.ERROR else self._told)(record.getMessage())


@contextmanager
def logged_to(told: Callable[[str], None]) -> Iterator[None]:
    """Print what is logged meanwhile, such as that kernels are compiled; an error always, the rest as told.

    Args:
        told: called with each text, which would come in the middle of a progress line otherwise.
    """
    log, handler = logging.getLogger("cosim"), _Told(told)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


@final
class Interruption:
    """While entered, the first signal asks the running loop to stop; a second one stops at once.

    Before the loop runs there is nothing to save, so a signal then raises KeyboardInterrupt too. SIGHUP stays
    ignored where it is ignored when the program starts (`nohup`); a second one, which shell and terminal send
    one after the other, asks for nothing more.
    """

    def __init__(self) -> None:
        self.signal_number: int | None = None
        self._running = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> "Interruption":
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @property
    def exit_code(self) -> int:
        """128 plus the signal's number, as shells have it."""
        return 128 + (self.signal_number or signal.SIGINT)

    def reason(self) -> str | None:
        """Return why the loop should stop, or None."""
        return None if self.signal_number is None else signal.Signals(self.signal_number).name

    def open(self, stage: snapshot.RunInfo) -> None:
        """Note that the loop runs: from here on there is something to save."""
        self._running = True

    def observe(self, batch: tick_batch.TickBatch) -> None:
        """Nothing to do; `reason` is asked after every batch."""

    def close(self) -> None:
        """Nothing to do; the files are still being closed."""

    def _handle(self, number: int, frame: FrameType | None) -> None:
        repeated = self.signal_number is not None
        if repeated and number == signal.SIGHUP:
            return
        self.signal_number = number
        if repeated or not self._running:
            raise KeyboardInterrupt
