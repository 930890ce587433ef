"""A run's recording as a video file."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from cosim.errors import InputError, OutputError
from cosim.recording.viewing.pictures import SIZE, Pictures


def write_video(
    recordings: Sequence[Path],
    path: Path,
    *,
    size: tuple[int, int] = SIZE,
    view: str | None = None,
    frames_per_s: float = 25.0,
    speed: float = 1.0,
    shown: Callable[[int, int], None] = lambda done, frames: None,
) -> int:
    """Write a video of a recording, from its begin to its end, and return how many frames it has.

    Args:
        recordings: files of one run, in order.
        path: of the video; what it ends with says its kind, such as .mp4. Nothing is there until all is done.
        size: (2,) of a frame [pixels]; both even.
        view: name of the only view to show; None for all of them, as laid out.
        frames_per_s: of the video.
        speed: simulated seconds per second of the video.
        shown: told how many of how many frames are drawn.

    Raises:
        InputError: a value cannot be used, there is no such view, or imageio-ffmpeg is not installed.
        OutputError: there is no driver to draw with, or the file cannot be written.
    """
    if not (0.0 < frames_per_s < np.inf and 0.0 < speed < np.inf):
        raise InputError(f"{frames_per_s:g} frames per second, speed {speed:g}: both must be above 0")
    if min(size) < 2 or any(length % 2 for length in size):
        raise InputError(f"size {size[0]}x{size[1]}: width and height must be even numbers")
    program, step_s = _encoder(), speed / frames_per_s
    with Pictures(recordings, size, view) as pictures, _encoded(program, path, frames_per_s) as write:
        times = np.arange(0.0, pictures.end_s + 0.5 * step_s, step_s)
        for count, time_s in enumerate(times, 1):
            write(pictures.at(float(time_s)))
            shown(count, len(times))
    return len(times)


@contextmanager
def _encoded(program: str, path: Path, frames_per_s: float) -> Iterator[Callable[[bytes], object]]:
    """Give what takes a video's frames as PNGs; the file is there once all of them are.

    Raises:
        OutputError: it cannot be written.
    """
    part = path.with_name(f".part-{path.name}")
    options = ["-f", "image2pipe", "-c:v", "png", "-framerate", f"{frames_per_s:g}", "-i", "-"]
    command = [program, "-y", *options, "-pix_fmt", "yuv420p", str(part)]
    with TemporaryFile() as said:
        encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said)
        assert encoder.stdin is not None, "a pipe"
        try:
            with suppress(BrokenPipeError):  # the encoder says why itself
                yield encoder.stdin.write
                encoder.stdin.close()
            if encoder.wait() != 0:
                said.seek(0)
                lines = said.read().decode(errors="replace").split("\n")
                raise OutputError(f"{path}: cannot be written: {' '.join(lines[-3:]).strip()}")
            part.replace(path)
        finally:
            with suppress(BrokenPipeError):
                encoder.stdin.close()
            encoder.kill()
            encoder.wait()
            part.unlink(missing_ok=True)


def _encoder() -> str:
    """Return the program that writes videos.

    Raises:
        InputError: it is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError("videos need imageio-ffmpeg: pip install 'cosim[video]'") from error
    return str(imageio_ffmpeg.get_ffmpeg_exe())
