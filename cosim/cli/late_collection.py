"""Disables Python's garbage collection until a run has started or a file has been checked, and leaves the
objects of the start out of later collections: they are not garbage.
"""

import gc
from types import TracebackType
from typing import Any, Self, final


@final
class LateCollection:
    """A context manager that disables garbage collection until the first ticks that it observes, or `begin`.

    Modules, kernels and engines are hundreds of thousands of objects. Collections during their import take a
    tenth of the time of a start, and one look at all of them takes 0.1 s.
    """

    def __enter__(self) -> Self:
        self._was_enabled = gc.isenabled()
        gc.disable()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.begin()
        if self._was_enabled:
            gc.unfreeze()

    def open(self, stage: Any) -> None:
        """Do nothing."""

    def observe(self, batch: Any) -> None:
        """Enable collection at the first ticks."""
        self.begin()

    def close(self) -> None:
        """Do nothing: the command ends."""

    def begin(self) -> None:
        """Enable collection of objects made from now on, if collection was enabled before."""
        if self._was_enabled and not gc.isenabled():
            gc.freeze()
            gc.enable()
