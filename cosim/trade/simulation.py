"""What a trade needs of a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol, TypeAlias

from cosim.config.schema.scenario import Scenario
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch


class Steps(Protocol):
    """Something that can be stepped."""

    @property
    def stage(self) -> RunInfo:
        """Everything that does not change during the run."""

    def batches(self) -> Iterator[TickBatch]:
        """Yield the state before the first tick, then those after the ticks, many at a time."""


Build: TypeAlias = Callable[[Scenario], Steps]
