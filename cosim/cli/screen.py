"""What the command line prints: texts that come from files cannot steer the terminal."""

from __future__ import annotations

import os
import re
import sys
from contextlib import suppress
from typing import TextIO

_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with control characters, but tabs and line breaks, as their escape sequences."""
    return _STEERING.sub(lambda found: found.group().encode("unicode_escape").decode("ascii"), text)


def tell(text: str, stream: TextIO | None = None) -> None:
    """Print a text as a line, on stderr unless another stream is given; do nothing where nobody reads it."""
    draw(printable(text) + "\n", stream or sys.stderr)


def draw(text: str, stream: TextIO) -> None:
    """Write a text as it is; a run goes on when only the screen is gone."""
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
