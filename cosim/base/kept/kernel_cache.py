"""Machine code that is kept on disk and serves no more."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from cosim.base.kernels import source_hash

_OLD_S = 7 * 24 * 3600.0


def remove_old(kernels: Iterable[Any]) -> None:
    """Delete machine code of other versions of kernels, if it was made more than a week ago.

    Args:
        kernels: dispatchers.
    """
    for kernel in kernels:
        kept = kernel._cache
        folder, base = Path(kept.cache_path), kept._impl.filename_base
        own = f"{base}-{source_hash(Path(kernel.py_func.__code__.co_filename).resolve())}."
        with suppress(OSError):  # another process may do the same
            for path in folder.glob(f"{base}[-.]*.nb[ic]"):
                if not path.name.startswith(own) and time.time() - path.stat().st_mtime > _OLD_S:
                    path.unlink()
