"""Writes files completely or not at all: a reader sees the new contents, or the old ones."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from cosim.errors import OutputError


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


def rewrite(path: Path, data: bytes) -> None:
    """Put other contents into a file that is there; links to it, its mode and its owner stay.

    A file that took its place would cut hard links and lose the mode and owner, so the file itself is
    overwritten. Its old contents are on the disk in `NAME.PID.before` until the new ones are: they are put
    back where writing fails, and are what a process that is killed in between leaves.

    Args:
        path: of the file, or a symbolic link to it.
        data: new contents.

    Raises:
        OSError: it cannot be read or written; it has its old contents, or they are in `NAME.PID.before`.
    """
    target = path.resolve(strict=True)
    before = target.read_bytes()
    spare = target.with_name(f"{target.name}.{os.getpid()}.before")
    spare.touch(mode=0o600, exist_ok=False)  # what only its owner may read stays so
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
    """Return what processes that were killed in the middle of writing a file have left."""
    found = path.parent.glob(f"{path.name}.*.part")
    return [entry for entry in found if entry.name[len(path.name) + 1 : -len(".part")].isdecimal()]


@contextmanager
def writing(path: object) -> Iterator[None]:
    """Name the file that cannot be written within.

    Raises:
        OutputError: in place of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
