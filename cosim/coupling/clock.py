"""The lockstep clock: time is a count of ticks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.errors import InputError


@final
@dataclass(frozen=True)
class Clock:
    """An integer count of equal ticks; time never accumulates rounding.

    Args:
        tick_s: length of a tick [s].
        tick: ticks since the start.
    """

    tick_s: float
    tick: int = 0

    def __post_init__(self) -> None:
        if not self.tick_s > 0.0:
            raise InputError(f"tick_s is {self.tick_s}; it must be above 0")

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.tick * self.tick_s

    def advanced(self, ticks: int = 1) -> Clock:
        """Return the clock some ticks later."""
        return Clock(self.tick_s, self.tick + ticks)
