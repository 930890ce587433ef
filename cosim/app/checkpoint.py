"""Checkpoints, from which a run continues: written at intervals, and when the run ends early."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

from cosim.app.run_files import CHECKPOINT, RunFiles
from cosim.base import state_file
from cosim.base.identity import code_identity
from cosim.base.whole_files import unfinished_files
from cosim.telemetry.summary import Status, SummaryBuilder, SummaryState
from cosim.telemetry.tick_batch import Snapshot, TickBatch

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun

_SAVE_TICKS: Final = 20
"""Least ticks between two states in memory: saving costs time, as the next factorisation needs a copy."""
_SAVE_EVERY_s: Final = 0.1
"""Wall time that ticks between two states in memory take at least; less is quickly solved again."""
_SAVE_AT_LAST_s: Final = 1.0
"""Wall time after which a state is saved, however few ticks there were."""


@final
@dataclass(frozen=True)
class Checkpoint:
    """A run between two ticks.

    Args:
        run: state of the simulation.
        summary: figures so far, with the last snapshot.
        first: first snapshot of the run, which sets the layout of recordings.
        run_id: common to all recordings of the run.
        startup_s: wall time of all starts so far.
        wall_s: wall time of all loops over the ticks so far.
        resumed_at_ticks: ticks after which the run resumed so far.
    """

    run: Any
    summary: SummaryState
    first: Snapshot
    run_id: str
    startup_s: float
    wall_s: float
    resumed_at_ticks: tuple[int, ...]


@final
@dataclass(frozen=True)
class Origin:
    """Start of a loop over the ticks of a run.

    Args:
        run_id: common to all recordings of the run.
        startup_s: wall time of all starts, this one included.
        wall_s: wall time of all earlier loops.
        resumed_at_ticks: ticks after which the run resumed, this time included.
        checkpoint: from which the loop continues; None for a new run.
    """

    run_id: str
    startup_s: float = 0.0
    wall_s: float = 0.0
    resumed_at_ticks: tuple[int, ...] = ()
    checkpoint: Checkpoint | None = None

    @classmethod
    def of(cls, run_id: str, checkpoint: Checkpoint | None) -> Origin:
        """Return the start of a new run with an id, or of a part that continues from a checkpoint."""
        if checkpoint is None:
            return cls(run_id)
        return cls(
            checkpoint.run_id,
            checkpoint.startup_s,
            checkpoint.wall_s,
            (*checkpoint.resumed_at_ticks, checkpoint.summary.tick),
            checkpoint,
        )

    def after(self, startup_s: float) -> Origin:
        """Return the same with the wall time of this start added."""
        return replace(self, startup_s=self.startup_s + startup_s)

    @property
    def before(self) -> tuple[Snapshot, Snapshot] | None:
        """First snapshot of the run, and the last one before this loop; None for a new run."""
        return self.checkpoint and (self.checkpoint.first, self.checkpoint.summary.seen)


@final
@dataclass(frozen=True)
class _Saved:
    """A state in memory.

    Args:
        run: state of the simulation.
        summary: figures of the same tick.
    """

    run: Any
    summary: SummaryState


@final
class CheckpointKeeper:
    """Saves states in memory, and writes checkpoints at intervals and when the run ends early.

    Args:
        simulation: the run.
        summary: of the run; it observes all ticks first.
        origin: of the loop.
        files: of the run.
        every_s: wall time between two checkpoints; infinite: only at an early end.
        before_writing: writes the other files of the run up to the checkpoint's tick.
    """

    def __init__(
        self,
        simulation: SteppedRun,
        summary: SummaryBuilder,
        origin: Origin,
        files: RunFiles,
        every_s: float,
        before_writing: Callable[[], None],
    ) -> None:
        self._simulation, self._summary, self._origin = simulation, summary, origin
        self._files, self._path = files, files.directory / CHECKPOINT
        self._every_s, self._before_writing = every_s, before_writing
        before = origin.checkpoint
        self._first = before and before.first
        self._saved = before and _Saved(before.run, before.summary)
        self._age_ticks = 0
        self._began = self._written = self._saved_at = time.perf_counter()

    def observe(self, batch: TickBatch) -> None:
        """Save a state in memory if the last one is old; the summary has observed these ticks before."""
        self._first = self._first or batch.snapshot(0).kept()
        self._age_ticks += len(batch)
        age_s = time.perf_counter() - self._saved_at
        old = age_s >= _SAVE_EVERY_s and (self._age_ticks >= _SAVE_TICKS or age_s >= _SAVE_AT_LAST_s)
        if (old and self._simulation.saves_now) or self._saved is None:
            self._save()

    def write_when_due(self, _batch: TickBatch) -> None:
        """Write a checkpoint if the last one is old; all other observers come before."""
        if time.perf_counter() - self._written >= self._every_s and self._simulation.saves_now:
            self._before_writing()
            self._save()
            self._write()
            self._written = time.perf_counter()

    def end(self, status: Status, error: BaseException | None) -> None:
        """Write the last state of a run that ended early; remove the checkpoint of a completed run.

        Args:
            status: how the run ended.
            error: that was raised in the middle of a tick, if any.
        """
        if status == "completed":
            for path in (self._path, *unfinished_files(self._path)):
                path.unlink(missing_ok=True)
            return
        if error is None and self._simulation.saves_now:
            self._save()
        elif error is None or isinstance(error, Exception):
            self._solve_again()
        # after Ctrl-C in the middle of a tick, the user waits no longer: the state in memory is written
        self._write()

    def _save(self) -> None:
        self._saved = _Saved(self._simulation.save_state(), self._summary.state)
        self._age_ticks, self._saved_at = 0, time.perf_counter()

    def _solve_again(self) -> None:
        """Solve the ticks from the state in memory to the failure again, bit-identically, and save."""
        if self._saved is None:
            return
        missing = self._summary.state.tick - self._saved.summary.tick
        try:
            self._simulation.restore_state(self._saved.run)
            if missing > 0:
                self._simulation.advance(missing)
        except Exception:  # an older state is better than none
            return
        self._save()

    def _write(self) -> None:
        """Write the state in memory; nothing before the first snapshot."""
        if self._saved is None or self._first is None:
            return
        saved, origin = self._saved, self._origin
        wall_s = origin.wall_s + time.perf_counter() - self._began
        state = Checkpoint(
            saved.run, saved.summary, self._first, origin.run_id, origin.startup_s, wall_s,
            origin.resumed_at_ticks,
        )  # fmt: skip
        header = {
            "tick": saved.summary.tick,
            "loaded": dict(self._files.loaded),
            "written_by": code_identity(),
        }
        try:
            for path in unfinished_files(self._path):  # of a process that was killed
                path.unlink(missing_ok=True)
            state_file.save(self._path, state, header)
        except (OSError, TypeError) as error:  # a full disk, or a controller's state of an unknown kind
            # the run is not affected, and its other files will be written
            warnings.warn(f"no checkpoint could be written: {error}", RuntimeWarning, stacklevel=2)
