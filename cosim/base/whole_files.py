"""Writes files completely or not at all: a reader sees the new contents, or the old ones."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces a file at the end of the block; an exception deletes it.

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


def rewrite(path: Path, data: bytes) -> None:
    """Overwrite an existing file; hard links to it, its mode and its owner remain.

    Replacing the file would cut hard links and lose mode and owner. The old contents are saved in
    `NAME.PID.before` until the new ones are on the disk. They are restored if writing fails, and remain there
    if the process is killed in between.

    Args:
        path: of the file, or a symbolic link to it.
        data: new contents.

    Raises:
        OSError: it cannot be read or written; the old contents are in the file or in `NAME.PID.before`.
    """
    target = path.resolve(strict=True)
    before = target.read_bytes()
    spare = target.with_name(f"{target.name}.{os.getpid()}.before")
    spare.touch(mode=0o600, exist_ok=False)  # readable for the owner alone
    try:
        _overwrite(spare, before)
    except BaseException:
        spare.unlink()
        raise
    try:
        _overwrite(target, data)
    except BaseException:
        _overwrite(target, before)
        spare.unlink()
        raise
    spare.unlink()


def _overwrite(path: Path, data: bytes) -> None:
    with path.open("r+b") as file:
        file.write(data)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())


def unfinished_files(path: Path) -> list[Path]:
    """Return the temporary files of killed processes that were writing a file."""
    parts = path.parent.glob(f"{path.name}.*.part")
    return [entry for entry in parts if entry.name[len(path.name) + 1 : -len(".part")].isdecimal()]
