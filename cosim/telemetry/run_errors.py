"""Error bars of a run."""

from dataclasses import dataclass, field
from typing import Any, final


@final
@dataclass(frozen=True)
class RunErrors:
    """How far the figures at the ends of phases may be off; docs/run_error.md.

    Args:
        phases: by the phase's index: each figure's bar, None if it has no bar, what it is made of, and
            the `reason` why.
        reason: why phases are left out; None where none is.
        iterations: on the refined mesh.
        wall_s: that it took.
    """

    phases: dict[int, dict[str, Any]] = field(default_factory=dict)
    reason: str | None = None
    iterations: int = 0
    wall_s: float = 0.0
