"""The designs of a sweep: tasks that are sent to workers, and rows that come back."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol, final

from cosim.config.schema.scenario import Scenario
from cosim.sweeps.measure import Measure

if TYPE_CHECKING:
    from cosim.telemetry.run_info import RunInfo
    from cosim.telemetry.tick_batch import TickBatch

LOST: Final = "lost"
"""Status of a design whose worker died."""


class DesignFollower(Protocol):
    """Observes the run of a design in its worker; a dataclass whose fields identify it before the run."""

    def open(self, stage: RunInfo) -> None:
        """Begin a run."""

    def observe(self, batch: TickBatch) -> None:
        """Process some ticks."""

    def stop(self) -> str | None:
        """Return a reason to stop the run; None to continue."""

    def close(self) -> None:
        """End the run, completed or not."""

    def figures(self, command_cpu_s: float) -> dict[str, Any]:
        """Return figures of a completed run, as values of JSON.

        Args:
            command_cpu_s: CPU time that the run would take as a command of its own.
        """


@final
@dataclass(frozen=True)
class Task:
    """A design to run, as it is sent to a worker.

    Args:
        scenario: pickled, since `modules` may define the kinds of its tables.
        modules: imported first.
        measure: function of the result, or its name; None for none.
        directory: of the run's files; None writes none.
        follower: observer of this run; None for none.
    """

    scenario: bytes
    modules: tuple[str, ...] = ()
    measure: Measure | str | None = None
    directory: str | None = None
    follower: DesignFollower | None = None

    @classmethod
    def of(cls, scenario: Scenario, **how: Any) -> Task:
        """Return the task of a checked scenario."""
        return cls(pickle.dumps(scenario), **how)


@final
@dataclass(frozen=True)
class Row:
    """Result of a design.

    Args:
        status: "completed", "failed", "interrupted" (by its follower), "refused" (it cannot be built) or
            "lost" (its worker died).
        reason: why it is not completed.
        figures: numbers of the run, by name; of a failed run, until then.
        wall_s: wall time of the run, without the preparation of its process.
        cpu_s: CPU time of the run, the same.
        worker: name of the process.
        files: digests of the files that were read while building, by name; see `cosim.base.files`.
    """

    status: str
    reason: str | None = None
    figures: dict[str, Any] | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0
    worker: str = ""
    files: dict[str, str] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Design:
    """A design with its result.

    Args:
        varied: values by key path.
        identity: hash of its contents; empty if it cannot be loaded.
        row: its result.
    """

    varied: Mapping[str, Any]
    identity: str
    row: Row
