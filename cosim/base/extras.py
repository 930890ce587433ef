"""Libraries that come with an optional extra of the package, loaded where they are used.

Videos are written by the program that comes with imageio-ffmpeg.
"""

from __future__ import annotations

import importlib
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from cosim.errors import InputError, OutputError


def extra_module(name: str, extra: str) -> Any:
    """Return a module of a library that is part of an extra.

    Args:
        name: of the module.
        extra: that installs it, such as "pattern".

    Raises:
        InputError: it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        library = name.partition(".")[0]
        raise InputError(f"this needs {library}: pip install 'cosim[{extra}]'") from None


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
    """Give what takes a video's frames; the file is there once all of them are.

    Args:
        path: of the video.
        source: options of ffmpeg that say what the frames are.
        options: of the video.

    Raises:
        InputError: imageio-ffmpeg is not installed.
        OutputError: it cannot be written.
    """
    part = path.with_name(f".part-{path.name}")
    command = [encoder(), "-y", *source, "-i", "-", *options, str(part)]
    with TemporaryFile() as said:
        running = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said)
        assert running.stdin is not None, "a pipe"
        try:
            with suppress(BrokenPipeError):  # the encoder says why itself
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
