"""Keeps the arrays of a run on disk while it lasts, beside its recording."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import final

from cosim.app.run_files import ARRAYS, FRAMES, images_file
from cosim.errors import OutputError
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.results.array_files import write_arrays, write_images
from cosim.results.result import ResultBuilder
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch


@final
class ArrayRecorder(Recorder):
    """Writes what was gathered as its own part, at every checkpoint and at the end.

    Args:
        next_part: returns the path of the next part of a file, by the name of its first part.
        frames_per_s: how often node positions are kept, in simulated time.
        part: of the run.
    """

    def __init__(self, next_part: Callable[[str], Path], frames_per_s: float, part: RecordingPart) -> None:
        self._next_part, self._frames_per_s = next_part, frames_per_s
        self._gathered = ResultBuilder(frames_per_s, None if part.before is None else part.before[1].time_s)
        self._stage: RunInfo | None = None
        self._written = False

    def open(self, stage: RunInfo) -> None:
        """Take in what does not change during the run."""
        self._stage = stage

    def record(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        self._gathered.observe(batch)

    def flush(self) -> None:
        """Write what was gathered since the last time; where it cannot be, it is tried again later."""
        with suppress(OutputError):
            self._write()

    def close(self, summary_markdown: str, status: str) -> None:
        """Write what is left; an empty part if there is nothing at all.

        Raises:
            OutputError: it cannot be written.
        """
        self._write()

    def _write(self) -> None:
        arrays = self._gathered.arrays()
        if self._stage is not None and (len(arrays["tick"]) or not self._written):
            write_arrays(
                self._next_part(ARRAYS), self._next_part(FRAMES), self._stage, self._frames_per_s, arrays
            )
            for camera, images in self._gathered.images().items():
                write_images(self._next_part(images_file(camera)), camera, images)
            self._gathered.forget()
            self._written = True
