"""The progress of a trade: which member runs, how far it is, and what became of those before."""

from __future__ import annotations

from typing import TextIO, final

from cosim.cli.screen import draw
from cosim.trade.measured import Measured
from cosim.trade.measuring import Telling
from cosim.trade.member import Candidate
from cosim.trade.report import result_line


@final
class TradeProgress:
    """Draws one line that renews itself on a terminal, and one for every member that is done.

    Args:
        stream: where to draw, usually stderr.
        count: of members.
    """

    def __init__(self, stream: TextIO, count: int) -> None:
        self._stream, self._count = stream, count
        self._terminal = stream.isatty()
        self._place, self._name = 0, ""
        self.telling = Telling(self.begin, self.advance, self.done)

    def begin(self, place: int, member: Candidate) -> None:
        """A member begins."""
        self._place, self._name = place, member.name
        self.advance(0.0)

    def advance(self, share: float) -> None:
        """So much of its run is done; shown on a terminal only."""
        if self._terminal:
            self._write(f"\r\x1b[K{self._head} {self._name}: {100 * share:.0f} %")

    def done(self, result: Measured) -> None:
        """A member is done."""
        start = "\r\x1b[K" if self._terminal else ""
        self._write(f"{start}{self._head} {result_line(result)}\n")

    @property
    def _head(self) -> str:
        return f"[{self._place + 1}/{self._count}]"

    def _write(self, text: str) -> None:
        draw(text, self._stream)
