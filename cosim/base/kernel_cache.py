"""Where machine code is kept: under a hash of all the source that went into it.

numba itself looks at the file of a kernel alone. What is inlined from another file, and a number that is
imported, would stay what they were when that file changes.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORT = re.compile(r"^\s*(?:from|import) cosim\.?([\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)
_OLD_S = 7 * 24 * 3600.0


def keep_by_source(dispatcher: Any) -> None:
    """Let a cached kernel be kept, where numba keeps it, under the hash of its source.

    Args:
        dispatcher: of a function of cosim, declared with `cache=True`.
    """
    kept = dispatcher._cache  # numba has no public way to say what else a kernel depends on
    place = kept._impl
    path = Path(dispatcher.py_func.__code__.co_filename).resolve()
    name = f"{place.filename_base}-{source_hash(path)}"
    kept._cache_file = IndexDataCacheFile(kept.cache_path, name, place.locator.get_source_stamp())


@cache
def source_hash(path: Path) -> str:
    """Return a hash of a file and of all files of cosim that it imports, to any depth."""
    digest, found, to_do = sha256(), {path}, [path]
    while to_do:
        for imported in _imports(to_do.pop()) - found:
            found.add(imported)
            to_do.append(imported)
    for entry in sorted(found):
        digest.update(_text(entry).encode())
    return digest.hexdigest()[:12]


def remove_old(kernels: Iterable[Any]) -> None:
    """Delete machine code of other versions of kernels, if it was made more than a week ago.

    Args:
        kernels: dispatchers of `keep_by_source`.
    """
    for kernel in kernels:
        kept = kernel._cache
        folder, base = Path(kept.cache_path), kept._impl.filename_base
        own = f"{base}-{source_hash(Path(kernel.py_func.__code__.co_filename).resolve())}."
        with suppress(OSError):  # another process may do the same
            for path in folder.glob(f"{base}[-.]*.nb[ic]"):
                if not path.name.startswith(own) and time.time() - path.stat().st_mtime > _OLD_S:
                    path.unlink()


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Return the files of cosim that a file imports."""
    found = set()
    for module, names in _IMPORT.findall(_text(path)):
        folder = _PACKAGE.joinpath(*module.split(".")) if module else _PACKAGE
        for name in ("", *re.findall(r"\w+", names)):
            candidate = (folder / name if name else folder).with_suffix(".py")
            if candidate.is_file():
                found.add(candidate)
    return frozenset(found)
