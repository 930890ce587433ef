"""What every recorder offers to a run."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, final

from cosim.telemetry import snapshot, tick_batch


@final
@dataclass(frozen=True)
class RecordingPart:
    """Which part of a run a recording holds; the parts of one run open as one recording.

    Args:
        run_id: of the run.
        before: first snapshot of the run and the one that this part continues from; None in the first part.
    """

    run_id: str
    before: tuple[snapshot.Snapshot, snapshot.Snapshot] | None = None


class Recorder(ABC):
    """Receives the stage once, then the ticks of a run in order, then the outcome."""

    @abstractmethod
    def open(self, stage: snapshot.RunInfo) -> None:
        """Begin a recording.

        Args:
            stage: what does not change during the run.
        """

    def lay_out(self, first: snapshot.Snapshot) -> None:  # noqa: B027
        """Prepare for a first snapshot that is known before it is recorded; not needed.

        Args:
            first: which will be recorded first.
        """

    @abstractmethod
    def record(self, batch: tick_batch.TickBatch) -> None:
        """Take in some ticks of one phase; they must rise.

        Args:
            batch: the ticks. Recorders may keep them: the arrays must not be reused.
        """

    def of_arms(self, names: Sequence[str]) -> "Mapping[str, Recorder]":
        """Return a recorder for each of several arms in a scene, by its name, all of this recording."""
        raise NotImplementedError("it knows one arm")

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:  # noqa: B027
        """Show how far figures may be off at the ends of phases; not needed.

        Args:
            phases: by their index, each figure's bar, or None.
        """

    @abstractmethod
    def flush(self) -> None:
        """Bring what was recorded so far to the disk."""

    @abstractmethod
    def close(self, summary_markdown: str, status: str) -> None:
        """Finish the recording so that it can be read, however the run ended.

        Args:
            summary_markdown: what a person should know of the run.
            status: how it ended, such as "completed", "interrupted" or "failed".
        """


@final
class Recorders(Recorder):
    """Several recorders as one; whatever one of them raises in closing, the others are closed.

    Args:
        recorders: any number; none records nothing.
    """

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        self._recorders = recorders

    def open(self, stage: snapshot.RunInfo) -> None:
        """Open all."""
        for recorder in self._recorders:
            recorder.open(stage)

    def lay_out(self, first: snapshot.Snapshot) -> None:
        """Prepare all."""
        for recorder in self._recorders:
            recorder.lay_out(first)

    def record(self, batch: tick_batch.TickBatch) -> None:
        """Let all record."""
        for recorder in self._recorders:
            recorder.record(batch)

    def mark_errors(self, phases: Mapping[int, dict[str, Any]]) -> None:
        """Let all show them."""
        for recorder in self._recorders:
            recorder.mark_errors(phases)

    def flush(self) -> None:
        """Flush all."""
        for recorder in self._recorders:
            recorder.flush()

    def close(self, summary_markdown: str, status: str) -> None:
        """Close all."""
        with ExitStack() as stack:  # the first one is closed last: its error is told
            for recorder in self._recorders:
                stack.callback(recorder.close, summary_markdown, status)
