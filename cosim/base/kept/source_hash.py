"""What a kernel's machine code depends on: the source of all that it was made of."""

from __future__ import annotations

import re
from functools import cache
from hashlib import sha256
from pathlib import Path

import llvmlite.binding as llvm
import numba

_PACKAGE = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(r"^\s*(?:from|import) cosim\.?([\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)


@cache
def source_hash(path: Path) -> str:
    """Return a hash of a file, of all files of cosim that it imports, to any depth, and of the compiler."""
    compiler = f"{numba.__version__} for {llvm.get_host_cpu_name()}"
    digest, found, to_do = sha256(compiler.encode()), {path}, [path]
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
    """Return the files of cosim that a file imports."""
    found = set()
    for module, names in _IMPORT.findall(_text(path)):
        folder = _PACKAGE.joinpath(*module.split(".")) if module else _PACKAGE
        for name in ("", *re.findall(r"\w+", names)):
            candidate = (folder / name if name else folder).with_suffix(".py")
            if candidate.is_file():
                found.add(candidate)
    return frozenset(found)
