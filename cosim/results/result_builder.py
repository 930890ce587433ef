"""Gathers the arrays of a run while it lasts."""

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from cosim._version import __version__
from cosim.base.frames import Array, IntArray
from cosim.results.result import CameraImages, RunResult
from cosim.results.run_columns import COLUMNS, FRAME_COLUMNS, IMAGE_COLUMNS
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.summary import Status, SummaryBuilder, reason_of
from cosim.telemetry.tick_batch import TickBatch

_ROUNDING_S: Final = 1e-9
"""Far below a tick, far above the rounding error of a time."""


@final
class ResultBuilder:
    """Observes a run and gathers its arrays.

    Args:
        frames_per_s: frames with node positions, per second of simulated time.
        after_s: simulated time from which the run continues; None: its start.
    """

    def __init__(self, frames_per_s: float, after_s: float | None = None) -> None:
        self._stage: RunInfo | None = None
        self._frames_per_s = frames_per_s
        self._frame = -1 if after_s is None else int(_frames(np.array([after_s]), frames_per_s)[0])
        self._gathered: dict[str, list[Any]] = {name: [] for name in (*COLUMNS, *FRAME_COLUMNS)}
        self._images: dict[str, list[tuple[Any, ...]]] = {}

    def open(self, stage: RunInfo) -> None:
        """Begin a run."""
        self._stage = stage

    def observe(self, batch: TickBatch) -> None:
        """Add some ticks."""
        for name in COLUMNS:
            self._gathered[name].append(getattr(batch, name))
        rows = frame_rows(batch.time_s, self._frames_per_s, self._frame)
        self._frame = int(_frames(batch.time_s[-1:], self._frames_per_s)[0])
        if len(rows):
            self._gathered["frame_tick"].append(batch.tick[rows])
            self._gathered["frame_time_s"].append(batch.time_s[rows])
            self._gathered["node_position"].append(batch.film.some(rows).node_position())
        for row, images in batch.images.items():
            for one in images:
                values = (one.rgb, one.depth_m, one.segments, one.position, one.rotation)
                image = (batch.tick[row], batch.time_s[row], *values)
                self._images.setdefault(one.camera, []).append(image)

    def arrays(self) -> dict[str, Any]:
        """Return the arrays of all gathered ticks, by name."""
        gathered = self._gathered.items()
        return {name: _joined(parts) if parts else np.zeros(0) for name, parts in gathered}

    def images(self) -> dict[str, CameraImages]:
        """Return the gathered images, by camera."""
        return {
            name: CameraImages(dict(zip(IMAGE_COLUMNS, map(np.array, zip(*rows, strict=True)), strict=True)))
            for name, rows in self._images.items()
        }

    def forget(self) -> None:
        """Drop all gathered ticks; the times of frames continue."""
        self._gathered, self._images = {name: [] for name in self._gathered}, {}

    def close(self) -> None:
        """Do nothing."""

    def result(self, summary: dict[str, Any], directory: Path | None) -> RunResult:
        """Return the arrays of all ticks so far.

        Raises:
            ValueError: the run has not been opened.
        """
        if self._stage is None:
            raise ValueError("no run has been opened")
        return RunResult(self._stage, summary, directory, self.arrays(), self.images())


def frame_rows(time_s: Array, frames_per_s: float, before: int = -1) -> IntArray:
    """Return the rows of frames: the first row of each.

    Args:
        time_s: (rows,), ascending.
        frames_per_s: frames per second.
        before: frame of the row before these, counted from 0.
    """
    return np.flatnonzero(np.diff(_frames(time_s, frames_per_s), prepend=before))


def _frames(time_s: Array, frames_per_s: float) -> IntArray:
    """Return the frame of each time, counted from 0."""
    return np.floor((time_s + _ROUNDING_S) / (1.0 / frames_per_s)).astype(np.int64)


def _joined(parts: list[Any]) -> Any:
    """Return the rows of all parts; ticks before a length was commanded have no cables, here NaN."""
    shape = max(part.shape[1:] for part in parts)
    return np.concatenate([
        part if part.shape[1:] == shape else np.full((len(part), *shape), np.nan) for part in parts
    ])  # fmt: skip


def result_of(
    stage: RunInfo, frames_per_s: float, batches: Iterable[TickBatch], error: BaseException | None = None
) -> RunResult:
    """Return the result of some ticks of a run that was stepped by hand, and of the error that ended it."""
    arrays, summary = ResultBuilder(frames_per_s), SummaryBuilder(stage, 0.0, __version__)
    arrays.open(stage)
    began = time.perf_counter()
    for batch in batches:
        arrays.observe(summary.observe(batch))
    ended: tuple[Status, str | None] = ("completed", None) if error is None else ("failed", reason_of(error))
    figures = summary.finish(*ended, time.perf_counter() - began)
    return arrays.result(figures, None)
