"""What a trade needs of a simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol, TypeAlias

from cosim.config.schema.scenario import Scenario
from cosim.telemetry.snapshot import RunInfo, Snapshot


class Steps(Protocol):
    """Something that can be stepped."""

    @property
    def stage(self) -> RunInfo:
        """Everything that does not change during the run."""

    def steps(self, ahead: int = 1) -> Iterator[Snapshot]:
        """Yield the state before the first tick, then that after every tick; `ahead` may be taken before."""


Build: TypeAlias = Callable[[Scenario], Steps]
