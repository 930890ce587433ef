"""Writes the arrays of a run to files while it lasts."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import final

from cosim.app.run_files import ARRAYS, FRAMES, images_file
from cosim.errors import InputError, OutputError
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
        with suppress(OutputError, InputError):  # InputError: the directory's list of files is full as well
            self._write()

    def close(self, summary_markdown: str, status: str) -> None:
        """Write the remaining ticks; an empty part if there are no ticks at all.

        Raises:
            OutputError: a file cannot be written.
        """
        self._write()

    def _write(self) -> None:
        """Write all files of a part, or none: ticks in a file of a part that failed would be there twice."""
        arrays, images = self._gathered.arrays(), self._gathered.images()
        if self._stage is None or (self._written and not len(arrays["tick"])):
            return
        paths = {name: self._next_part(name) for name in (ARRAYS, FRAMES, *map(images_file, images))}
        try:
            write_arrays(paths[ARRAYS], paths[FRAMES], self._stage, self._frames_per_s, arrays)
            for camera, taken in images.items():
                write_images(paths[images_file(camera)], camera, taken)
        except OutputError:
            for path in paths.values():
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            raise
        self._gathered.forget()
        self._written = True
