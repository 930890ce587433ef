"""What the command line prints: texts that come from files cannot steer the terminal."""

from __future__ import annotations

import re
import sys
from typing import TextIO

_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text with control characters, but tabs and line breaks, as their escape sequences."""
    return _STEERING.sub(lambda found: found.group().encode("unicode_escape").decode("ascii"), text)


def tell(text: str, stream: TextIO | None = None) -> None:
    """Print a text as a line, on stderr unless another stream is given."""
    print(printable(text), file=stream or sys.stderr, flush=True)
