"""What travels to a worker and back: a design, and its row."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from typing import Any, Final, final

from cosim.config.schema.scenario import Scenario
from cosim.sweeps.measures import Measure

LOST: Final = "lost"
"""Status of a design whose worker died."""


@final
@dataclass(frozen=True)
class Task:
    """A design to run, as it travels to a worker.

    Args:
        scenario: pickled, since its tables may be of kinds that `modules` make known.
        modules: to import first.
        measure: function of the result, or its name; None for none.
        directory: of the run's files; None keeps none.
    """

    scenario: bytes
    modules: tuple[str, ...] = ()
    measure: Measure | str | None = None
    directory: str | None = None

    @classmethod
    def of(cls, scenario: Scenario, **how: Any) -> Task:
        """Return the task of a checked scenario."""
        return cls(pickle.dumps(scenario), **how)


@final
@dataclass(frozen=True)
class Row:
    """What came out of a design.

    Args:
        status: "completed", "failed", "refused" (it cannot be built) or "lost" (its worker died).
        reason: why it is not completed.
        figures: numbers of the run, by name; up to where it failed.
        wall_s: wall time of the run, without what the first one of a process waits for.
        cpu_s: CPU time of the run, the same.
        worker: which process it was.
        files: digests of the files that building it read, by names; see `cosim.base.files_read`.
    """

    status: str
    reason: str | None = None
    figures: dict[str, Any] | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0
    worker: str = ""
    files: dict[str, str] = field(default_factory=dict)
