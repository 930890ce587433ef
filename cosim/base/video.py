"""Writes videos with the ffmpeg that imageio-ffmpeg includes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from cosim.base.resources import extra_module
from cosim.errors import OutputError


def encoder() -> str:
    """Return the program that writes videos.

    Raises:
        InputError: it is not installed.
    """
    return str(extra_module("imageio_ffmpeg", "video").get_ffmpeg_exe())


@contextmanager
def encoded(
    path: Path, source: Sequence[str], options: Sequence[str] = ("-pix_fmt", "yuv420p")
) -> Iterator[Callable[[bytes], object]]:
    """Yield a function that writes the bytes of a frame; the video replaces its file at the end of the block.

    Args:
        path: of the video.
        source: options of ffmpeg for the format of the frames.
        options: of the video.

    Raises:
        InputError: imageio-ffmpeg is not installed.
        OutputError: it cannot be written.
    """
    import subprocess  # here: few commands write a video
    from tempfile import TemporaryFile

    part = path.with_name(f".part-{path.name}")
    command = [encoder(), "-y", *source, "-i", "-", *options, str(part)]
    with TemporaryFile() as said:
        running = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said)
        assert running.stdin is not None, "a pipe"
        try:
            with suppress(BrokenPipeError):  # ffmpeg reports why
                yield running.stdin.write
                running.stdin.close()
            if running.wait() != 0:
                said.seek(0)
                lines = said.read().decode(errors="replace").split("\n")
                raise OutputError(f"{path}: cannot be written: {' '.join(lines[-3:]).strip()}")
            part.replace(path)
        finally:
            with suppress(BrokenPipeError):
                running.stdin.close()
            running.kill()
            running.wait()
            part.unlink(missing_ok=True)
