"""Error bars of a run."""

from dataclasses import dataclass, field
from typing import Any, final


@final
@dataclass(frozen=True)
class RunErrors:
    """Error bars of the figures at the ends of phases; see docs/run_error.md.

    Args:
        phases: by the phase's index: each figure's bar with its parts, None if it has no bar, and the
            `reason` why.
        reason: why phases are left out; None if none is.
        iterations: on the refined mesh.
        wall_s: wall time.
    """

    phases: dict[int, dict[str, Any]] = field(default_factory=dict)
    reason: str | None = None
    iterations: int = 0
    wall_s: float = 0.0
