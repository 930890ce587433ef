"""What can be saved and restored while it runs.

A state is a frozen dataclass of arrays, numbers, texts, tuples, None and further frozen dataclasses. It may
share arrays with the object it was taken from: whoever writes to an array in place saves a copy of it.
"""

from __future__ import annotations

from typing import Protocol, TypeVar

State = TypeVar("State")


class Stateful(Protocol[State]):
    """Continues from a saved state as it went on from there the first time, bit for bit."""

    def save_state(self) -> State:
        """Return everything that the next step depends on."""

    def restore_state(self, state: State) -> None:
        """Return to a state of `save_state`, of this object or of one that was made alike."""
