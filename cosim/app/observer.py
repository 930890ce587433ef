"""What follows a run while it lasts."""

from __future__ import annotations

from typing import Protocol

from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch


class Observer(Protocol):
    """What follows a run while it lasts."""

    def open(self, stage: RunInfo) -> None:
        """The simulation is built; nothing has been written yet.

        Args:
            stage: names, shapes and triangles, of which nothing changes while the run lasts.
        """

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks of one phase.

        Args:
            batch: the ticks, in order; `batch.snapshot(k)` shows one of them.
        """

    def close(self) -> None:
        """The run has ended, one way or another."""
