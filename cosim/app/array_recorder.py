"""Writes the arrays of a run to files while it lasts."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import final

from cosim.app.run_files import ARRAYS, FRAMES, images_file
from cosim.errors import OutputError
from cosim.recording.recorder import Recorder, RecordingPart
from cosim.results.array_files import write_arrays, write_images
from cosim.results.result_builder import ResultBuilder
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch


@final
class ArrayRecorder(Recorder):
    """Writes the gathered ticks as a part, at every checkpoint and at the end.

    Args:
        next_part: returns the path of the next part of a file, by the name of its first part.
        frames_per_s: frames with node positions, per second of simulated time.
        part: of the run.
    """

    def __init__(self, next_part: Callable[[str], Path], frames_per_s: float, part: RecordingPart) -> None:
        self._next_part, self._frames_per_s = next_part, frames_per_s
        self._gathered = ResultBuilder(frames_per_s, None if part.before is None else part.before[1].time_s)
        self._stage: RunInfo | None = None
        self._written = False

    def open(self, stage: RunInfo) -> None:
        """Begin a run."""
        self._stage = stage

    def record(self, batch: TickBatch) -> None:
        """Add some ticks."""
        self._gathered.observe(batch)

    def flush(self) -> None:
        """Write the ticks gathered since the last time; if that fails, they are written later."""
        with suppress(OutputError):
            self._write()

    def close(self, summary_markdown: str, status: str) -> None:
        """Write the remaining ticks; an empty part if there are no ticks at all.

        Raises:
            OutputError: a file cannot be written.
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
