"""Natural modes of a soft robot as moving shapes in a recording, each a phase of 2 s with two swings.

A file of its own: it makes a made-up run for the recorder, which knows nothing of modes.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.soft_sides.soft_side import MeshReader
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.assembly import SoftSystem
from cosim.telemetry.snapshot import RunInfo, Snapshot, UnreadFilmShape
from cosim.telemetry.tick_batch import TickBatch

_FRAME_s: Final = 1.0 / 30.0
_FRAMES: Final = 60  # of each mode
_SWING: Final = 0.08  # of the film's size


def write_mode_shapes(
    path: Path, stage: RunInfo, here: Snapshot, body: SoftBody, modes: Mapping[str, Array]
) -> None:
    """Write a recording of modes; the largest motion of a node is 8 % of the film's size, and does not decay.

    Args:
        path: of the recording; an old file is replaced.
        stage: of the run that they are of.
        here: what they swing about.
        body: whose nodes they move.
        modes: shapes (n, 3), complex, the largest component by 1, by what they are called.

    Raises:
        OutputError: the file cannot be written.
    """
    ticks = len(modes) * _FRAMES
    own = replace(
        stage, title=f"Natural modes: {stage.title}", tick_s=_FRAME_s, ticks=ticks,
        duration_s=ticks * _FRAME_s, phase_names=tuple(modes), tip_paths={}, energy=None, cameras=(),
    )  # fmt: skip
    recorder = RerunRecorder(path, frames_per_s=2.0 / _FRAME_s)  # every tick is a frame
    recorder.open(own)
    for batch in _swings(here, body, list(modes.values())):
        recorder.record(batch)
    recorder.close("\n".join(f"- {name}" for name in modes), "completed")


def _swings(here: Snapshot, body: SoftBody, shapes: list[Array]) -> Iterator[TickBatch]:
    """Yield the frames of each mode."""
    reader, rest = MeshReader(body, SoftSystem(body).gas.enclosed_volumes), np.array(here.node_position)
    swing = _SWING * float(np.ptp(rest, axis=0).max())
    turns = np.exp(4j * np.pi * np.arange(_FRAMES) / _FRAMES)
    for k, shape in enumerate(shapes):
        films = [np.ascontiguousarray(rest + swing * (shape * turn).real) for turn in turns]
        yield TickBatch.of([
            _frame(here, UnreadFilmShape(reader, film), k, k * _FRAMES + j) for j, film in enumerate(films)
        ])  # fmt: skip


def _frame(here: Snapshot, film: UnreadFilmShape, mode: int, tick: int) -> Snapshot:
    return replace(
        here, tick=tick, time_s=tick * _FRAME_s, phase=mode, film=film, footing=None, branchings=(),
        overlaps=(), handovers=(), images=(), tip_target=None,
    )  # fmt: skip
