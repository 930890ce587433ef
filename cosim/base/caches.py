"""The cache on disk, with one policy for kernels, plans and section models. Each kind has a folder of its
name in `$COSIM_CACHE_DIR`. Without that variable, plans and section models are in the user's cache folder, or
else in the package's `__pycache__`; kernels are in the package, or else in the user's folder. The first
writable folder is used, and folders of root are read as well. Kernels are read with pickle, so whoever can
write to their folder could run code: folders that others own or may write to are not used. The name of a
file, or of its folder, contains a hash of everything that its content depends on, versions included. Damaged
files are deleted with a warning. If the files of a kind exceed `MOST_BYTES`, the least recently used are
deleted.
"""

import os
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Final, TypeVar

from cosim.base import writing

KERNELS, PLANS, SECTION_MODELS = KINDS = ("kernels", "plans", "section_models")
VARIABLE: Final = "COSIM_CACHE_DIR"
MOST_BYTES: Final = 1_000_000_000
"""Of each kind."""

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_OTHERS_WRITE: Final = 0o022  # group and others, in a folder's mode
_DAY_S: Final = 24 * 3600.0
_MARK: Final = b"kept by cosim, sha256 "
_BYTES: Final[dict[Path | None, int]] = {}
"""In each folder of a kind, as this process knows it."""

Kind = TypeVar("Kind")


def folders(kind: str) -> tuple[Path | None, tuple[Path, ...]]:
    """Return the folder to which a kind is written, and those of root from which it is read as well.

    The first is made if need be, readable for everybody if root makes it; None where nothing can be written.

    Args:
        kind: of `KINDS`.
    """
    chosen, places = os.environ.get(VARIABLE), [_PACKAGE / "__pycache__"]
    with suppress(RuntimeError):  # a user without a home
        base = os.environ.get("XDG_CACHE_HOME")
        user = (Path(base) if base else Path.home() / ".cache") / "cosim"
        places = [user, *places] if kind != KERNELS else [*places, user]
    if chosen:
        places = [Path(chosen), *(place for place in places if place.parent != _PACKAGE)]
    return _usable(tuple(place / kind for place in places))


@cache
def _usable(places: tuple[Path, ...]) -> tuple[Path | None, tuple[Path, ...]]:
    user, own, of_root = os.getuid(), None, list[Path]()
    for folder in places:
        try:
            if own is None:
                folder.mkdir(mode=_mode(), parents=True, exist_ok=True)
            status = folder.stat()
        except OSError:
            continue
        if own is not None and status.st_uid != 0:
            continue
        if status.st_uid not in (user, 0) or status.st_mode & _OTHERS_WRITE:
            what = "it is not used, as whoever writes to it could run code"
            remedy = f"delete it, or make it yours alone: chmod 700 {folder}"
            warnings.warn(
                f"{folder}: others own it or may write to it; {what}; {remedy}", RuntimeWarning, stacklevel=3
            )
        elif status.st_uid == user and os.access(folder, os.W_OK | os.X_OK):
            own = own or folder
        elif os.access(folder, os.X_OK):
            of_root.append(folder)
    return own, tuple(of_root)


def _mode() -> int:
    """Return the mode of a new folder: what root makes everybody may read."""
    return 0o700 if os.getuid() else 0o755


def keep(kind: str, name: str, data: bytes) -> None:
    """Keep data under a name, no more than `MOST_BYTES` of a kind; what cannot be written is made again.

    Args:
        kind: of `KINDS`.
        name: of the file, or "folder/name".
        data: any bytes.
    """
    folder = folders(kind)[0]
    if folder is not None:
        path = folder / name
        with suppress(OSError):
            for place in (folder, path.parent):
                place.mkdir(mode=_mode(), parents=True, exist_ok=True)
            with writing.whole_file(path) as file:
                file.write(_MARK + sha256(data).hexdigest().encode() + b"\n" + data)
        _trim(kind, len(data))


def kept(kind: str, name: str, read: Callable[[bytes], Kind]) -> Kind | None:
    """Return what was kept under a name; None where there is nothing sound.

    Args:
        kind: of `KINDS`.
        name: of the file, or "folder/name".
        read: makes it of the data.
    """
    own, of_root = folders(kind)
    found = (_sound(folder / name, read) for folder in (own, *of_root) if folder is not None)
    return next((one for one in found if one is not None), None)


def _sound(path: Path, read: Callable[[bytes], Kind]) -> Kind | None:
    """Return the content of a file; None if there is no such file, or, with a warning, if it is damaged."""
    try:
        mark, _, data = path.read_bytes().partition(b"\n")
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _DAY_S:
                os.utime(path)  # see `_trim`
    except FileNotFoundError:
        return None
    except OSError as error:
        reason = error.strerror or "cannot be read"
    else:
        if mark == _MARK + sha256(data).hexdigest().encode():
            try:
                return read(data)
            except Exception as error:  # another version of cosim may have kept other things
                reason = f"is of another version ({type(error).__name__})"
        else:
            reason = "is damaged"
    warnings.warn(f"{path}: {reason}; its content is computed again", RuntimeWarning, stacklevel=2)
    with suppress(OSError):
        path.unlink()
    return None


def _trim(kind: str, added: int) -> None:
    """Delete the files of a kind that were not used for longest, as far as they are too many bytes.

    Args:
        kind: of `KINDS`.
        added: [bytes], since the last call; files are counted at the first one, and where too many may be.
    """
    folder = folders(kind)[0]
    if folder is None or (folder in _BYTES and _BYTES[folder] + added <= MOST_BYTES):
        _BYTES[folder] = _BYTES.get(folder, 0) + added
        return
    total = 0
    with suppress(OSError):  # another process may do the same
        for path, status in sorted(_files(kind), key=lambda one: -one[1].st_mtime):
            if total + status.st_size > MOST_BYTES:
                _delete(path)
            else:
                total += status.st_size
    _BYTES[folder] = total


def clear() -> None:
    """Delete all that is kept in folders to which this user writes."""
    for kind in KINDS:
        for path, _ in _files(kind):
            _delete(path)


def _delete(path: Path) -> None:
    """Delete a file, and its folder with the last one."""
    path.unlink(missing_ok=True)
    with suppress(OSError):  # others are in it
        path.parent.rmdir()


def lines() -> list[str]:
    """Return a line for each kind: number of files, size, and folder."""
    rows = []
    for kind in KINDS:
        sizes, folder = [status.st_size for _, status in _files(kind)], folders(kind)[0]
        rows.append(f"{kind:<15} {len(sizes):>5} files {1e-6 * sum(sizes):>8.1f} MB  {folder or 'not kept'}")
    return rows


def _files(kind: str) -> list[tuple[Path, os.stat_result]]:
    folder = folders(kind)[0]
    found = [] if folder is None else folder.rglob("*")
    return [(path, path.stat()) for path in found if path.is_file()]
