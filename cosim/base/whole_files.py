"""Files that are written whole: a reader sees all of one, or what was there before."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes its place when the block ends well, and leaves nothing when it does not.

    Args:
        path: of the file; its directory exists.

    Raises:
        OSError: it cannot be written.
    """
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("wb") as file:
            yield file
        os.replace(unfinished, path)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text in UTF-8.

    Raises:
        OSError: it cannot be written.
    """
    data = text.encode()
    with whole_file(path) as file:
        file.write(data)


def unfinished_files(path: Path) -> list[Path]:
    """Return what processes that were killed in the middle of writing a file have left."""
    found = path.parent.glob(f"{path.name}.*.part")
    return [entry for entry in found if entry.name[len(path.name) + 1 : -len(".part")].isdecimal()]
