"""Steps that are shown together: what is shown one by one costs more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

from cosim.telemetry.snapshot import Snapshot
from cosim.telemetry.tick_batch import TickBatch

_GATHERED: Final = 64
"""Steps that make a batch, where few are taken at once: fine meshes are large."""
_GATHERED_S: Final = 0.1
"""Wall time of steps after which a batch is shown, though it has fewer."""


@final
class Gathering:
    """Steps of one phase in the order in which they were taken, one by one or in rows.

    Args:
        together: steps that may be taken before the first of them is shown, at least one.
    """

    def __init__(self, together: int) -> None:
        self._most = min(_GATHERED, together)
        self._rows: list[TickBatch] = []
        self._single: list[Snapshot] = []
        self._count, self._spent_s = 0, 0.0

    def __len__(self) -> int:
        return self._count

    @property
    def full(self) -> bool:
        """Whether they are to be shown."""
        return self._count >= self._most or self._spent_s >= _GATHERED_S

    def add(self, taken: Sequence[Snapshot] | TickBatch) -> None:
        """Add what was taken next."""
        self._count += len(taken)
        if isinstance(taken, TickBatch):
            self._rows = [*self._parts(), taken]
            self._single = []
            self._spent_s += float(taken.tick_wall_s.sum())
        else:
            self._single += taken
            self._spent_s += sum(snapshot.tick_wall_s for snapshot in taken)

    def shown(self) -> TickBatch:
        """Return all of them, at least one, and begin anew."""
        parts = self._parts()
        self._rows, self._single, self._count, self._spent_s = [], [], 0, 0.0
        return parts[0] if len(parts) == 1 else TickBatch.joined(parts)

    def _parts(self) -> list[TickBatch]:
        return [*self._rows, TickBatch.of(self._single)] if self._single else self._rows
