"""The interface of recorders, which a run calls with its ticks, and a recorder that passes every call to
several others.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, final

from cosim.telemetry import run_info, tick_batch


@final
@dataclass(frozen=True)
class RecordingPart:
    """The part of a run that a recording contains; the parts of one run open as one recording.

    Args:
        run_id: of the run.
        before: first snapshot of the run and the snapshot that this part continues from; None in the first
            part.
    """

    run_id: str
    before: tuple[tick_batch.Snapshot, tick_batch.Snapshot] | None = None


class Recorder(ABC):
    """Records a run: first its constants, then its ticks in order, then its outcome."""

    @abstractmethod
    def open(self, stage: run_info.RunInfo) -> None:
        """Begin a recording.

        Args:
            stage: constants of the run.
        """

    def lay_out(self, first: tick_batch.Snapshot) -> None:  # noqa: B027
        """Prepare for the first snapshot before it is recorded; optional.

        Args:
            first: the snapshot that will be recorded first.
        """

    @abstractmethod
    def record(self, batch: tick_batch.TickBatch) -> None:
        """Record some ticks of one phase, in rising order.

        Args:
            batch: the ticks. A recorder may keep its arrays, so they must not be reused.
        """

    def of_arms(self, names: Sequence[str]) -> "Mapping[str, Recorder]":
        """Return a recorder for each arm of a scene, by its name; all write to this recording."""
        raise NotImplementedError("it records one arm only")

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:  # noqa: B027
        """Show error bars of figures at the ends of phases; optional.

        Args:
            phases: error bars by the figure's key in a summary, or None, by the index of the phase.
        """

    @abstractmethod
    def flush(self) -> None:
        """Write the ticks so far to the disk."""

    @abstractmethod
    def close(self, summary_markdown: str, status: str) -> None:
        """Finish the recording so that it can be read, however the run ended.

        Args:
            summary_markdown: summary of the run, for people.
            status: how it ended, such as "completed", "interrupted" or "failed".
        """


@final
class Recorders(Recorder):
    """Passes every call to several recorders; if one of them raises while closing, the others are closed too.

    Args:
        recorders: any number, or none.
    """

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        self._recorders = recorders

    def open(self, stage: run_info.RunInfo) -> None:
        """Open all."""
        for recorder in self._recorders:
            recorder.open(stage)

    def lay_out(self, first: tick_batch.Snapshot) -> None:
        """Lay out all."""
        for recorder in self._recorders:
            recorder.lay_out(first)

    def record(self, batch: tick_batch.TickBatch) -> None:
        """Record with all."""
        for recorder in self._recorders:
            recorder.record(batch)

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:
        """Show error bars in all."""
        for recorder in self._recorders:
            recorder.mark_errors(phases)

    def flush(self) -> None:
        """Flush all."""
        for recorder in self._recorders:
            recorder.flush()

    def close(self, summary_markdown: str, status: str) -> None:
        """Close all."""
        with ExitStack() as stack:  # the first one is closed last, so its error is raised
            for recorder in self._recorders:
                stack.callback(recorder.close, summary_markdown, status)
