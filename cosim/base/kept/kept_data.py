"""Data that takes long to make and is kept on disk: what comes back is what was put there, or nothing."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from cosim.base.whole_files import whole_file

Kind = TypeVar("Kind")

_MARK = b"kept by cosim, sha256 "


def keep(path: Path, data: bytes) -> None:
    """Keep data under a name; where nothing can be written they are made again the next time.

    Args:
        path: of the file; its directory is made.
        data: any bytes.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write(_MARK + sha256(data).hexdigest().encode() + b"\n" + data)
    except OSError:
        return


def kept(path: Path, read: Callable[[bytes], Kind]) -> Kind | None:
    """Return what was kept; None where there is nothing, and with a warning where it is damaged.

    Args:
        path: of the file.
        read: makes it of the data.
    """
    try:
        mark, _, data = path.read_bytes().partition(b"\n")
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
    warnings.warn(f"{path}: {reason}; what it held is made anew", RuntimeWarning, stacklevel=2)
    return None
