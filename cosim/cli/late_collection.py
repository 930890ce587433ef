"""Turns Python's garbage collection off until a run has started, because the objects that are made until then
stay.
"""

import gc
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, final

if TYPE_CHECKING:
    pass


@final
class LateCollection:
    """Puts the collection of garbage off, from where it is entered to the first ticks that it is shown.

    Modules, kernels and engines are hundreds of thousands of objects, which Python would look through again
    and again while they are being loaded: that takes a tenth of a start.
    """

    def __enter__(self) -> Self:
        self._found = gc.isenabled()
        gc.disable()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._begin()

    def open(self, stage: Any) -> None:
        """Wait for the first ticks."""

    def observe(self, batch: Any) -> None:
        """Collect from here on, if that was so before."""
        self._begin()

    def close(self) -> None:
        """Do nothing: the command ends."""

    def _begin(self) -> None:
        if self._found:
            gc.enable()
