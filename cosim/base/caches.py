"""The cache on disk, with one policy for kernels, plans and section models. Each kind has a folder of its
name in `$COSIM_CACHE_DIR`. Without that variable, plans and section models are in the user's cache folder, or
else in the package's `__pycache__`; kernels are in the package, or else in the user's folder. The first
writable folder is used, and folders of root are read as well. Kernels are read with pickle, so whoever can
write to their folder could run code: folders that others own or may write to are not used. The name of a
file, or of its folder, contains a hash of everything that its content depends on, versions included. Damaged
files are deleted with a warning, those that another version of cosim wrote without one. If the files of a
kind exceed `MOST_BYTES`, the least recently used are deleted.
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

from cosim.base import platform, whole_files

KERNELS, PLANS, SECTION_MODELS = KINDS = ("kernels", "plans", "section_models")
VARIABLE: Final = "COSIM_CACHE_DIR"
MOST_BYTES: Final = 1_000_000_000
"""Of each kind."""

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_OTHERS_WRITE: Final = 0o022  # group and others, in a folder's mode
_DAY_S: Final = 24 * 3600.0
_MARK: Final = b"kept by cosim, sha256 "
_BYTES: Final[dict[Path | None, int]] = {}
"""Bytes in each folder, as this process last counted them."""

Kind = TypeVar("Kind")


def folders(kind: str) -> tuple[Path | None, tuple[Path, ...]]:
    """Return the folder that files of a kind are written to, and folders of root that are also read.

    The first folder is made if it is missing. If root makes it, everybody can read it. It is None if no
    folder is writable.

    Args:
        kind: of `KINDS`.
    """
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return _usable(kind, os.environ.get(VARIABLE), base)


@cache  # asked for every kernel
def _usable(kind: str, chosen: str | None, base: str) -> tuple[Path | None, tuple[Path, ...]]:
    """Return the first writable folder of the user, and the readable folders of root.

    Args:
        kind: of `KINDS`.
        chosen: folder of `VARIABLE`, or None.
        base: of the user's caches; begins with "~" for a user without a home.
    """
    parents = [_PACKAGE / "__pycache__"]
    if not base.startswith("~"):
        of_user = Path(base, "cosim")
        parents = [of_user, *parents] if kind != KERNELS else [*parents, of_user]
    if chosen:
        parents = [Path(chosen), *(folder for folder in parents if folder.parent != _PACKAGE)]
    candidates = [folder / kind for folder in parents]
    user, writable, of_root = platform.user_id(), None, list[Path]()
    for folder in candidates:
        try:
            if writable is None:
                folder.mkdir(mode=_mode(), parents=True, exist_ok=True)
            status = folder.stat()
        except OSError:
            continue
        if user is None:
            writable = writable or (folder if os.access(folder, os.W_OK) else None)
            continue
        if writable is not None and status.st_uid != 0:
            continue
        if status.st_uid not in (user, 0) or status.st_mode & _OTHERS_WRITE:
            what = "it is not used, as whoever writes to it could run code"
            remedy = f"delete it, or make it yours alone: chmod 700 {folder}"
            warnings.warn(
                f"{folder}: others own it or may write to it; {what}; {remedy}", RuntimeWarning, stacklevel=3
            )
        elif status.st_uid == user and os.access(folder, os.W_OK | os.X_OK):
            writable = writable or folder
        elif os.access(folder, os.X_OK):
            of_root.append(folder)
    return writable, tuple(of_root)


def _mode() -> int:
    """Return the mode of a new folder; everybody may read a folder that root makes."""
    return 0o755 if platform.user_id() == 0 else 0o700


def store(kind: str, name: str, data: bytes) -> None:
    """Write data to a file of the cache, and delete old files beyond `MOST_BYTES` of its kind.

    Does nothing if the file cannot be written; its content is then computed again in each process.

    Args:
        kind: of `KINDS`.
        name: of the file, or "folder/name".
        data: any bytes.
    """
    folder = folders(kind)[0]
    if folder is not None:
        path = folder / name
        with suppress(OSError):
            for parent in (folder, path.parent):
                parent.mkdir(mode=_mode(), parents=True, exist_ok=True)
            with whole_files.whole_file(path) as file:
                file.write(_MARK + sha256(data).hexdigest().encode() + b"\n" + data)
        _trim(kind, len(data))


def load(kind: str, name: str, read: Callable[[bytes], Kind]) -> Kind | None:
    """Return the content of a file of the cache; None if there is no undamaged file of that name.

    Args:
        kind: of `KINDS`.
        name: of the file, or "folder/name".
        read: converts the bytes of the file to its content.
    """
    writable, of_root = folders(kind)
    contents = (_undamaged(folder / name, read) for folder in (writable, *of_root) if folder is not None)
    return next((content for content in contents if content is not None), None)


def _undamaged(path: Path, read: Callable[[bytes], Kind]) -> Kind | None:
    """Return the content of a file; None if there is no such file, or none that this version can read.

    A damaged file is deleted with a warning.
    """
    reason: str | None = None
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
            with suppress(Exception):  # another version of cosim may have written other classes
                return read(data)
        else:
            reason = "is damaged"
    if reason is not None:
        warnings.warn(f"{path}: {reason}; its content is computed again", RuntimeWarning, stacklevel=2)
    with suppress(OSError):
        path.unlink()
    return None


def _trim(kind: str, added: int) -> None:
    """Delete the least recently used files of a kind, until `MOST_BYTES` are left.

    Args:
        kind: of `KINDS`.
        added: [bytes], since the last call; files are counted at the first call, and again once the limit
            may be exceeded.
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
    """Delete all files of the cache in folders that this user can write to."""
    for kind in KINDS:
        for path, _ in _files(kind):
            _delete(path)


def _delete(path: Path) -> None:
    """Delete a file, and its folder once that is empty."""
    path.unlink(missing_ok=True)
    with suppress(OSError):  # other files are in it
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
    paths = [] if folder is None else folder.rglob("*")
    return [(path, path.stat()) for path in paths if path.is_file()]
