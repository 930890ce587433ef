"""Prints texts and log messages of the command line. A run continues if its terminal is closed."""

import logging
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TextIO, final

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with control characters as escape sequences, except tabs and line breaks."""
    return _CONTROL.sub(lambda match: match.group().encode("unicode_escape").decode("ascii"), text)


def tell(text: str, stream: TextIO | None = None) -> None:
    """Print a text as a line, on stderr by default; does nothing if the stream is closed."""
    draw(printable(text) + "\n", stream or sys.stderr)


def draw(text: str, stream: TextIO) -> None:
    """Write a text without change; does nothing if the stream is closed."""
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError):
        mute(stream)


def mute(stream: TextIO) -> None:
    """Redirect a closed stream to the null device, with the data that it still buffers."""
    with suppress(OSError, ValueError):
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, stream.fileno())
        os.close(sink)


def open_missing_streams() -> None:
    """Open standard streams on the null device, for a process that was started without them."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  # for good


@final
class _MessageHandler(logging.Handler):
    def __init__(self, report: Callable[[str], None]) -> None:
        super().__init__()
        self._report = report

    def emit(self, record: logging.LogRecord) -> None:
        (tell if record.levelno >= logging.ERROR else self._report)(record.getMessage())


@contextmanager
def logged_to(report: Callable[[str], None]) -> Iterator[None]:
    """Pass the log messages of a block, such as that kernels are compiled, to a function; print errors.

    Args:
        report: called with each message below an error, such as a function that prints above a progress line.
    """
    log, handler = logging.getLogger("cosim"), _MessageHandler(report)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
