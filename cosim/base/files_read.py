"""The files that loading and building read: each is noted where it is read, with a digest of its contents.

Files are read far below whoever asks: by rules, by loaders of engines, by kinds of tables that users
register. A recorder passed through all of them is forgotten by the next reader, and its file is then missing
without a word. So whoever asks opens a block (`files_read`), held in a context variable of this module alone,
and every reader reads through `read_file`, or says `note_file` of a file that it hands to an engine. Outside
a block nothing is noted, and nothing depends on what is noted but the names of what was read.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Final

ABSENT: Final = "absent"
"""In place of the digest of a file that cannot be read."""

_HERE: Final = Path(__file__).resolve().parents[2]  # of the package's folder, and of a clone's robots/

_ASKED: Final[ContextVar[dict[str, str] | None]] = ContextVar("files_read", default=None)


@contextmanager
def files_read() -> Iterator[dict[str, str]]:
    """Gather what is read within a block: SHA-256 digests by names; blocks around it get them as well.

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
    """Note files that were read before, such as for a part that is taken instead of made.

    Args:
        found: as of `files_read`.
    """
    asked = _ASKED.get()
    if asked is not None:
        asked.update(found)


def read_file(path: Path, most_bytes: int) -> bytes:
    """Return the contents of a file, up to one byte more than are allowed; whoever reads it checks that.

    Raises:
        OSError: it cannot be read.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except OSError:
        note_read({_name(path): ABSENT})
        raise
    if _ASKED.get() is not None:
        note_read({_name(path): sha256(data).hexdigest()})
    return data


def note_file(path: Path) -> None:
    """Note a file that an engine is going to read."""
    if _ASKED.get() is not None:
        note_read({_name(path): _digest(path)})


def changed_file(before: Mapping[str, str], seen: dict[str, str] | None = None) -> str | None:
    """Return the name of a file that has other contents now; None where none has.

    Args:
        before: as of `files_read`.
        seen: digests that are known already; gets those that are taken here.
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
    """Return where files are that are installed, by the first parts of their names."""
    return (("cosim", _HERE), ("python", Path(sys.prefix).resolve()))
