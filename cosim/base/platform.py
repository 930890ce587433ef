"""What differs between operating systems: who the user is, locks of files, and the signal of a closed
terminal. Where a system has none of them, each says so by None.
"""

import os
import signal
from contextlib import suppress
from importlib import import_module
from typing import Any, Final

HANG_UP: Final[int | None] = getattr(signal, "SIGHUP", None)
"""Signal of a terminal that has been closed; None where there is none."""


def user_id() -> int | None:
    """Return the number of the user; None where users have no numbers, and folders of a user are private."""
    return os.getuid() if hasattr(os, "getuid") else None


def lock_file(descriptor: int) -> None:
    """Lock an open file for this process until it is closed; does nothing where files cannot be locked so.

    Args:
        descriptor: of the open file.

    Raises:
        BlockingIOError: another process has locked it.
    """
    locks: Any = None
    with suppress(ImportError):  # Windows
        locks = import_module("fcntl")
    if locks is None:
        return
    try:
        locks.flock(descriptor, locks.LOCK_EX | locks.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass  # a file system without locks
