"""A delay of whole ticks: what goes in comes out that many ticks later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.errors import InputError


@final
@dataclass(frozen=True)
class DelayLine:
    """Values on their way, the oldest first.

    Args:
        waiting: one value per tick of the delay; none without delay.
    """

    waiting: tuple[float, ...] = ()

    @classmethod
    def filled(cls, value: float, ticks: int) -> DelayLine:
        """Return a line of a number of ticks in which a value has stood for long.

        Raises:
            InputError: the number is negative.
        """
        if ticks < 0:
            raise InputError(f"a delay of {ticks} ticks; it must be 0 or more")
        return cls((value,) * ticks)

    def passed(self, value: float) -> tuple[float, DelayLine]:
        """Return what comes out when a value goes in, and the line afterwards."""
        oldest, *waiting = (*self.waiting, value)
        return oldest, DelayLine(tuple(waiting))
