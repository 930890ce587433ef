"""Reads files, and records which files a run has read, with a SHA-256 digest of each. Many modules read
files: rules of tables, loaders of engines, tables of users' kinds. A run opens the context manager
`files_read`; within it every call of `read_file` is recorded, and `note_file` records a file that an engine
reads. Outside of it nothing is recorded.
"""

import errno
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Final

LARGEST_TEXT_BYTES: Final = 4_000_000
ABSENT: Final = "absent"
"""Instead of a digest, if a file cannot be read."""

_HERE: Final = Path(__file__).resolve().parents[2]  # of the package's folder, and of a clone's robots/

_ASKED: Final[ContextVar[dict[str, str] | None]] = ContextVar("files_read", default=None)


@contextmanager
def files_read() -> Iterator[dict[str, str]]:
    """Record the files that are read within a block; outer blocks record them as well.

    Yields:
        SHA-256 digests by names of files.

    A file that comes with cosim or an installed package has a name relative to where that is installed:
    "cosim/robots/ur5e/arm.toml"; other names are absolute paths.
    """
    found: dict[str, str] = {}
    token = _ASKED.set(found)
    try:
        yield found
    finally:
        _ASKED.reset(token)
        note_read(found)


def note_read(found: Mapping[str, str]) -> None:
    """Record files that were read before, such as those of a part that comes from a cache.

    Args:
        found: as of `files_read`.
    """
    asked = _ASKED.get()
    if asked is not None:
        asked.update(found)


def read_text(path: Path) -> str:
    """Return the contents of a UTF-8 text, without a byte order mark.

    Raises:
        OSError: it cannot be read, is longer than any such file needs to be, or is not UTF-8.
    """
    try:
        return read_file(path, LARGEST_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"it is not UTF-8 text: byte {error.start}") from error


def read_file(path: Path, most_bytes: int) -> bytes:
    """Return the contents of a file.

    Raises:
        OSError: it cannot be read, or is longer than is allowed.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except OSError:
        note_read({_name(path): ABSENT})
        raise
    if _ASKED.get() is not None:
        note_read({_name(path): sha256(data).hexdigest()})
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it is longer than {most_bytes} bytes")
    return data


def note_file(path: Path) -> None:
    """Record a file that an engine is going to read."""
    if _ASKED.get() is not None:
        note_read({_name(path): _digest(path)})


def changed_file(before: Mapping[str, str], seen: dict[str, str] | None = None) -> str | None:
    """Return the name of a file whose content has changed; None if no file has changed.

    Args:
        before: digests of `files_read`.
        seen: present digests that were computed before; those that are computed here are added.
    """
    seen = {} if seen is None else seen
    return next((name for name in sorted(before) if _now(name, seen) != before[name]), None)


def _now(name: str, seen: dict[str, str]) -> str:
    if name not in seen:
        first, _, rest = name.partition("/")
        root = dict(_roots()).get(first)
        seen[name] = _digest(Path(name) if root is None else root / rest)
    return seen[name]


def _digest(path: Path) -> str:
    try:
        if not path.is_file():  # a folder, or a device, which may have no end
            return ABSENT
        with path.open("rb") as stream:
            return file_digest(stream, "sha256").hexdigest()
    except (OSError, ValueError):  # not there, or a path that no file can have
        return ABSENT


def _name(path: Path) -> str:
    here = path.resolve()
    for root, folder in _roots():
        if here.is_relative_to(folder):
            return f"{root}/{here.relative_to(folder).as_posix()}"
    return str(here)


def _roots() -> Iterable[tuple[str, Path]]:
    """Return the first parts of the names of installed files, and their folders."""
    return (("cosim", _HERE), ("python", Path(sys.prefix).resolve()))
