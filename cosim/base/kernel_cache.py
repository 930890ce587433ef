"""The machine code of kernels in the cache on disk. numba's own cache does not notice that a function of
another file was edited. Here the files are in a folder that is named by a hash of all source files with
kernels, of the compiler and of the processor, so after an edit the kernels are compiled again. The hash for
kernels outside of the package also contains all files of their package, or of their folder. The policy of the
folders is in `cosim.base.caches`.
"""

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, final

import llvmlite.binding as llvm
import numba
import numpy as np

from cosim.base import caches
from cosim.base.numba_insides import KNOWN, from_bytes, prepare_to_load, to_bytes

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_MARKS: Final = (b"cosim.base.kernel", b"\nfrom numba", b"\nimport numba")  # of a file with kernels
processor: Any = llvm.get_host_cpu_name
_NO_MATTER: Final = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")


@final
class KernelCache:
    """The cache of one kernel, as numba uses it: numba loads machine code from it, or compiles and saves it.

    `keeps` says whether the cache can be written.

    Args:
        function: of the kernel, in a file.
    """

    def __init__(self, function: Any) -> None:
        folder = caches.folders(caches.KERNELS)[0]
        self.keeps, self.cache_path = folder is not None, str(folder)
        path = Path(function.__code__.co_filename).resolve()
        self._base = f"{folder_of(path)}/{function.__module__}.{function.__qualname__}"
        self._origin = path.name, function.__code__.co_firstlineno  # two scripts may have one module name

    def name(self, signature: Any) -> str:
        """Return the name of the file for a signature, or a tuple of argument types."""
        return f"{self._base}-{sha256(f'{self._origin} {signature}'.encode()).hexdigest()[:8]}.nbc"

    def is_there(self, signature: Any) -> bool:
        """Return whether the cache has undamaged machine code of a signature."""
        return bool(caches.load(caches.KERNELS, self.name(signature), bool))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the compiled code of a signature; None if the cache has none."""
        prepare_to_load(context)
        return caches.load(caches.KERNELS, self.name(signature), lambda data: from_bytes(data, context))

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Write the compiled code of a signature, if the cache can be written."""
        if not self.keeps:
            return
        with suppress(*(() if KNOWN else (Exception,))):  # another version of numba may fail here
            data = to_bytes(compiled)
            if data is not None:
                caches.store(caches.KERNELS, self.name(signature), data)


def cache_of(function: Any) -> KernelCache | None:
    """Return the cache of a kernel; None if no folder is usable, or if its code is not all in files."""
    in_file = os.path.isfile(function.__code__.co_filename) and not function.__closure__
    return KernelCache(function) if in_file and any(caches.folders(caches.KERNELS)) else None


def folder_of(path: Path) -> str:
    """Return the name of the folder for the kernels in a file."""
    if path.is_relative_to(_PACKAGE):
        return _of_package()
    top = path.parent
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    return _of_others(top)


@cache
def _of_package() -> str:
    """Return a hash of this package's files with kernels, of the compiler, and of the processor."""
    settings = sorted(entry for entry in os.environ.items() if entry[0].startswith("NUMBA_"))
    chosen = [entry for entry in settings if entry[0] not in _NO_MATTER]
    versions = numba.__version__, np.__version__, sys.version_info[:2]
    texts = (path.read_bytes() for path in sorted(_PACKAGE.rglob("*.py")))
    return _hash_of(f"{versions} {KNOWN} {processor()} {chosen}", filter(has_kernels, texts))


@cache
def _of_others(top: Path) -> str:
    """Return a hash of the files of another package, or of a folder of scripts, and of `_of_package`."""
    sources = top.rglob("*.py") if (top / "__init__.py").is_file() else top.glob("*.py")
    return _hash_of(_of_package(), (path.read_bytes() for path in sorted(sources)))


def has_kernels(text: bytes) -> bool:
    """Return whether a source file of the package defines kernels, or sets how they are compiled."""
    return any(mark in text for mark in _MARKS)


def _hash_of(begin: str, texts: Iterable[bytes]) -> str:
    digest = sha256(begin.encode())
    for text in texts:
        digest.update(text)
    return digest.hexdigest()[:16]
