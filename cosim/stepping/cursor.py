"""Where in its plan a run is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Cursor:
    """Where in its plan a run is.

    Args:
        tick: steps taken in all.
        phase: index of the phase.
        done: steps taken in that phase.
    """

    tick: int = 0
    phase: int = 0
    done: int = 0

    def following(self, counts: Sequence[int]) -> Cursor | None:
        """Return where the next step ends, with so many steps in each phase; None at the end of the plan."""
        if self.done < counts[self.phase]:
            return Cursor(self.tick + 1, self.phase, self.done + 1)
        if self.phase + 1 < len(counts):
            return Cursor(self.tick + 1, self.phase + 1, 1)
        return None

    def later(self, steps: int) -> Cursor:
        """Return where so many steps later end, in the same phase."""
        return Cursor(self.tick + steps, self.phase, self.done + steps)
