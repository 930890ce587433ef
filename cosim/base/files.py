"""Files: read whole, noted, and written whole or not at all.

The files that loading and building read: each is noted where it is read, with a digest of its contents.

Files are read far below whoever asks: by rules, by loaders of engines, by kinds of tables that users
register. A recorder passed through all of them is forgotten by the next reader, and its file is then missing
without a word. So whoever asks opens a block (`files_read`), held in a context variable of this module alone,
and every reader reads through `read_file`, or says `note_file` of a file that it hands to an engine. Outside
a block nothing is noted, and nothing depends on what is noted but the names of what was read.

Files that are written whole: readers see all of it, what was before, or nothing.
"""

import errno
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from hashlib import file_digest, sha256
from pathlib import Path
from typing import BinaryIO, Final

LARGEST_TEXT_BYTES: Final = 4_000_000
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
