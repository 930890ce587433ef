"""Checkpoints: what a run needs to continue is written now and then, and when it ends early.

Checks of what a saved run shows of itself, and one line for whatever is wrong with its file.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np

from cosim.app.run_files import CHECKPOINT, SCENARIO, SUMMARY, RunFiles, scenario_digest
from cosim.base import resources, state_file
from cosim.base.column import check_arrays
from cosim.base.files import changed_file
from cosim.base.frames import Array
from cosim.base.identity import code_identity
from cosim.base.state_checks import check_indices, check_state
from cosim.base.whole_files import unfinished_files
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.summary import Status, SummaryBuilder, SummaryState
from cosim.telemetry.tick_batch import Snapshot, TickBatch

if TYPE_CHECKING:
    from cosim.stepping.stepped_run import SteppedRun


def sizes_of(stage: RunInfo) -> dict[str, int]:
    """Return the counts by which `check_state` judges what a simulation shows of itself."""
    return {
        "bodies": len(stage.body_names),
        "cables": len(stage.cables),
        "joints": len(stage.joint_names),
        "chambers": len(stage.chamber_names),
        "readings": sum(len(sensor.values) for sensor in stage.sensors),
    }


def check_shown(snapshot: Snapshot, stage: RunInfo) -> None:
    """Check that a saved snapshot is one of a stage: what draws it takes that for granted.

    Raises:
        InputError: it is not.
    """
    sizes, table = sizes_of(stage), snapshot.table
    check_state(table, None, TickBatch, place="snapshot", sizes=sizes, finite=False)
    check_arrays(table.arrays, TickBatch, 1, sizes, "snapshot")
    check_state(table.film._shapes, None, Annotated[Array, (1, "k", 3)], place="snapshot.film", finite=False)
    if table.film._reader is not None or len(table.devices) != 1:
        raise InputError("snapshot.film has not been read, or is of several ticks")
    check_indices(np.array([snapshot.phase]), len(stage.phase_names), "phases")
    check_indices(np.array([snapshot.tick]), stage.ticks + 1, "ticks")
    for nodes in (stage.soft_triangles, *stage.cables):
        check_indices(nodes, len(snapshot.node_position), "nodes")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn whatever a state that was made up raises into one line with the name of its file.

    Raises:
        InputError: in place of any other error.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # a state may be wrong in more ways than its kinds and sizes
        text = (str(error).splitlines() or [""])[0]
        raise InputError(f"{path}: does not fit this run ({type(error).__name__}: {text})") from error


_KEEP_TICKS = 20  # one for every tick would cost some percent: each makes the next factorisation a copy
_KEEP_S = 0.1  # fast ticks are solved again in no time
_KEEP_AT_LAST_S = 1.0


@final
@dataclass(frozen=True)
class Checkpoint:
    """A run between two ticks.

    Args:
        run: state of the simulation.
        summary: figures so far; holds the last snapshot.
        first: snapshot of the run; recordings take their layout from it.
        run_id: joins the recordings of the run.
        startup_s: wall time of all starts so far.
        wall_s: wall time of all loops over the ticks so far.
        resumed_at_ticks: where the run resumed before.
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
    """Where a loop over the ticks starts.

    Args:
        run_id: joins the recordings of a run.
        startup_s: wall time of all starts, this one included.
        wall_s: wall time of all loops before.
        resumed_at_ticks: ticks after which the run resumed, this time included.
        checkpoint: that it continues from.
    """

    run_id: str
    startup_s: float = 0.0
    wall_s: float = 0.0
    resumed_at_ticks: tuple[int, ...] = ()
    checkpoint: Checkpoint | None = None

    @classmethod
    def of(cls, run_id: str, checkpoint: Checkpoint | None) -> Origin:
        """Return the start of a new run of that name, or of the part that continues from a checkpoint."""
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
        """Return the same with the wall time of this start counted."""
        return replace(self, startup_s=self.startup_s + startup_s)

    @property
    def before(self) -> tuple[Snapshot, Snapshot] | None:
        """First snapshot of the run, and the one that the loop continues from; None for a new run."""
        return self.checkpoint and (self.checkpoint.first, self.checkpoint.summary.seen)


@final
class CheckpointKeeper:
    """Keeps a state in memory now and then, and writes one now and then and when the run ends early.

    Args:
        simulation: whose state.
        summary: whose figures; it sees all ticks first.
        origin: of the loop.
        files: of the run.
        every_s: wall time between two checkpoints; infinite for one at an early end only.
        before_writing: brings other files up to the tick of the checkpoint.
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
        self._kept: tuple[Any, SummaryState] | None = before and (before.run, before.summary)
        self._age_ticks = 0
        self._began = self._written = self._renewed = time.perf_counter()

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks; the summary has seen them already."""
        self._first = self._first or batch.snapshot(0).kept()
        self._age_ticks += len(batch)
        age_s = time.perf_counter() - self._renewed
        old = age_s >= _KEEP_S and (self._age_ticks >= _KEEP_TICKS or age_s >= _KEEP_AT_LAST_S)
        if (old and self._simulation.saves_now) or self._kept is None:
            self._keep()

    def write_when_due(self, _batch: TickBatch) -> None:
        """Write a checkpoint if the last one is old; everything else has seen the ticks already."""
        if time.perf_counter() - self._written >= self._every_s and self._simulation.saves_now:
            self._before_writing()
            self._keep()
            self._write()
            self._written = time.perf_counter()

    def end(self, status: Status, error: BaseException | None) -> None:
        """Write the state before what ended the run early; remove the checkpoint of a completed run.

        Args:
            status: how the run ended.
            error: what was raised, in the middle of a tick.
        """
        if status == "completed":
            for path in (self._path, *unfinished_files(self._path)):
                path.unlink(missing_ok=True)
            return
        if error is None and self._simulation.saves_now:
            self._keep()
        elif error is None or isinstance(error, Exception):
            self._catch_up()
        # whoever interrupts in the middle of a tick does not want to wait: the state in memory will do
        self._write()

    def _keep(self) -> None:
        self._kept = self._simulation.save_state(), self._summary.state
        self._age_ticks, self._renewed = 0, time.perf_counter()

    def _catch_up(self) -> None:
        """Solve again what was solved since the state in memory, bit for bit, up to the failure."""
        if self._kept is None:
            return
        run, figures = self._kept
        wanted = self._summary.state.tick
        try:
            self._simulation.restore_state(run)
            if figures.tick < wanted:
                self._simulation.advance(wanted - figures.tick)
        except Exception:  # whatever it is, the older state is better than none
            return
        self._keep()

    def _write(self) -> None:
        """Write the state that is kept; nothing before the first snapshot."""
        if self._kept is None or self._first is None:
            return
        run, summary = self._kept
        origin = self._origin
        wall_s = origin.wall_s + time.perf_counter() - self._began
        state = Checkpoint(
            run, summary, self._first, origin.run_id, origin.startup_s, wall_s, origin.resumed_at_ticks
        )
        header = {"tick": summary.tick, "loaded": dict(self._files.loaded), "written_by": code_identity()}
        try:
            for path in unfinished_files(self._path):  # of a process that was killed
                path.unlink(missing_ok=True)
            state_file.save(self._path, state, header)
        except (OSError, TypeError) as error:  # a full disk, or a controller's state of an unknown kind
            # the run itself is sound, and its other files are still to be written
            warnings.warn(f"no checkpoint could be written: {error}", RuntimeWarning, stacklevel=2)


def check_resumable(directory: Path) -> None:
    """Check that a directory holds a run that is not complete, with its checkpoint.

    Raises:
        InputError: there is no run, it is complete, or it left no checkpoint.
    """
    scenario, path, where = directory / SCENARIO, directory / CHECKPOINT, f"--resume {directory}:"
    if not resources.is_file(scenario):
        raise InputError(f"{where} holds no run, for want of a {SCENARIO}; start one: cosim run SCENARIO")
    if not resources.is_file(path):
        if _status(directory) == "completed":
            raise InputError(f"{where} this run is completed; nothing is left to do")
        raise InputError(f"{where} the run left no {CHECKPOINT}; start it again: cosim run {scenario}")


def tick_to_resume(directory: Path, scenario: Scenario) -> int:
    """Return the tick after which the run in a directory can continue.

    Args:
        directory: of the run.
        scenario: that was loaded to continue with.

    Raises:
        InputError: the checkpoint cannot be read, another program wrote it, or the scenario or a file that it
            names has been changed since.
    """
    file, path, where = directory / SCENARIO, directory / CHECKPOINT, f"--resume {directory}:"
    header = state_file.load_header(path)
    changed = changed_file(_table(header, "loaded"), {SCENARIO: scenario_digest(scenario)})
    if changed is not None:
        raise InputError(
            f"{where} {changed} has been changed since the run began; start it again, or branch from Python: "
            f"cosim.Simulation({str(file)!r}, start={str(path)!r})"
        )
    before, here = _table(header, "written_by"), code_identity()
    other = [f"{key} {before.get(key)} (now {here[key]})" for key in here if here[key] != before.get(key)]
    if other:
        raise InputError(
            f"{where} the checkpoint was written with {', '.join(other)}; its results "
            f"would differ; start it again: cosim run {file}"
        )
    tick = header.get("tick")
    if not isinstance(tick, int):
        raise InputError(f"{where} {CHECKPOINT} does not say after which tick it was written")
    return tick


def read_checkpoint(directory: Path, simulation: SteppedRun, stage: RunInfo) -> Checkpoint:
    """Return the checkpoint of a run, with the simulation, which has been built, brought to it.

    Args:
        directory: of the run.
        simulation: continues from there.
        stage: of the simulation.

    Raises:
        InputError: it cannot be read, or is not one of this simulation.
    """
    path = directory / CHECKPOINT
    found = state_file.load(path)
    if not isinstance(found, Checkpoint):
        raise InputError(f"{path}: holds no checkpoint but a {type(found).__name__}")
    with naming(path):
        check_state(found, None, Checkpoint, place="checkpoint", sizes=sizes_of(stage), finite=False)
        for snapshot in (found.first, found.summary.seen):
            check_shown(snapshot, stage)
        SummaryBuilder(stage, 0.0, "").state = found.summary
        simulation.restore_state(found.run)
    return found


def _table(header: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return a table of a header; an empty one where something else stands in its place."""
    found = header.get(key)
    return found if isinstance(found, dict) else {}


def _status(directory: Path) -> str | None:
    try:
        found = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return str(found.get("status")) if isinstance(found, dict) else None
