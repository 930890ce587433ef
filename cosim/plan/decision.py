"""One thing that a run models or leaves out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

SECTION_RANGE: Final = "motion within the section model's range"


@final
@dataclass(frozen=True)
class Decision:
    """Whether something is modelled, and why.

    Args:
        what: it is.
        included: whether it is modelled.
        reason: why, or why not.
        switch: key of the scenario that decides otherwise; "body" for a body given from Python.
    """

    what: str
    included: bool
    reason: str
    switch: str

    @property
    def line(self) -> str:
        """The decision in one line."""
        return f"{self.what}: {self.reason} ({self.switch})"
