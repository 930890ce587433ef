"""Machine code of kernels on disk: a folder for each state of the source that it may come from.

The folder is named by one hash of all files with kernels, of the compiler, and of the processor. numba's own
cache does not notice that a function was edited in another file; here that is another folder. Kernels outside
of the package have their own, by all files of their package, or beside them, as well. Where folders are, and
when files are deleted: `cosim.base.caches`.
"""

import os
import re
import sys
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, final

import llvmlite.binding as llvm
import numba
import numpy as np

from cosim.base import caches
from cosim.base.numba_insides import KNOWN, from_bytes, to_bytes

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_IMPORT: Final = re.compile(r"^\s*(?:from|import) (\.*)([\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)
processor: Any = llvm.get_host_cpu_name
_NO_MATTER: Final = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")


@final
class KernelCache:
    """Keeps a kernel's machine code: numba asks it before it compiles, and hands it what it has compiled.

    `keeps` says whether anything can be written.

    Args:
        function: of the kernel, in a file.
    """

    def __init__(self, function: Any) -> None:
        folder = caches.folders(caches.KERNELS)[0]
        self.keeps, self.cache_path = folder is not None, str(folder)
        place = folder_of(Path(function.__code__.co_filename).resolve())
        self._base = f"{place}/{function.__module__}.{function.__qualname__}"

    def name(self, signature: Any) -> str:
        """Return the name of the file for a signature, or a tuple of argument types."""
        return f"{self._base}-{sha256(str(signature).encode()).hexdigest()[:8]}.nbc"

    def is_there(self, signature: Any) -> bool:
        """Return whether there is sound machine code."""
        return bool(caches.kept(caches.KERNELS, self.name(signature), bool))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what is kept for a signature; None if there is nothing."""
        context.refresh()
        return caches.kept(caches.KERNELS, self.name(signature), lambda data: from_bytes(data, context))

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled, where it can be."""
        if not self.keeps:
            return
        with suppress(*(() if KNOWN else (Exception,))):  # another numba may keep other things
            data = to_bytes(compiled)
            if data is not None:
                caches.keep(caches.KERNELS, self.name(signature), data)


def cache_of(function: Any) -> KernelCache | None:
    """Return the cache of a kernel; None where no folder can be used, or its code is not all in files."""
    in_file = os.path.isfile(function.__code__.co_filename) and not function.__closure__
    return KernelCache(function) if in_file and any(caches.folders(caches.KERNELS)) else None


@cache
def folder_of(path: Path) -> str:
    """Return a name: the hash of a file, of those that it imports from its package, and of the compiler."""
    settings = sorted(entry for entry in os.environ.items() if entry[0].startswith("NUMBA_"))
    chosen = [entry for entry in settings if entry[0] not in _NO_MATTER]
    versions = numba.__version__, np.__version__, sys.version_info[:2]
    digest, found, to_do = sha256(f"{versions} {KNOWN} {processor()} {chosen}".encode()), {path}, [path]
    while to_do:
        for imported in _imports(to_do.pop()) - found:
            found.add(imported)
            to_do.append(imported)
    for entry in sorted(found):
        digest.update(_text(entry).encode())
    return digest.hexdigest()[:12]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Return the files that a file imports from cosim, from its own package, or from beside it."""
    top, found = path, set()
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    for dots, module, names in _IMPORT.findall(_text(path)):
        first = module.partition(".")[0]
        if dots:
            root = path.parents[len(dots) - 1]
        elif first == _PACKAGE.name:
            root = _PACKAGE.parent
        elif first == top.stem or (top == path and (top.parent / f"{first}.py").is_file()):
            root = top.parent
        else:
            continue
        folder = root.joinpath(*filter(None, module.split(".")))
        for name in ("", *re.findall(r"\w+", names)):
            candidate = (folder / name if name else folder).with_suffix(".py")
            if candidate.is_file():
                found.add(candidate)
    return frozenset(found)
