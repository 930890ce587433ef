"""Disables Python's garbage collection until a run has started or a file has been checked: the objects of the
start are not garbage.
"""

import gc
from types import TracebackType
from typing import Any, Self, final


@final
class LateCollection:
    """A context manager that disables garbage collection until the first ticks that it observes, or `begin`.

    Modules, kernels and engines are hundreds of thousands of objects. Collections during their import take a
    tenth of the time of a start.
    """

    def __enter__(self) -> Self:
        self._was_enabled = gc.isenabled()
        gc.disable()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.begin()

    def open(self, stage: Any) -> None:
        """Do nothing."""

    def observe(self, batch: Any) -> None:
        """Enable collection at the first ticks."""
        self.begin()

    def close(self) -> None:
        """Do nothing: the command ends."""

    def begin(self) -> None:
        """Enable collection, if it was enabled before."""
        if self._was_enabled:
            gc.enable()
