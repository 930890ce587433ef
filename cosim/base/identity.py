"""Digests of values and of the program: a short name of the contents of values, and versions of cosim and its
engines.
"""

import hashlib
import platform
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from cosim._version import __version__

_ENGINES = ("numpy", "scipy", "numba", "mujoco", "pin")


def content_name(*values: Any) -> str:
    """Return a short name of the contents of values: of all fields of dataclasses, to any depth.

    Args:
        values: numbers, texts, None, arrays, and tuples, lists, mappings and dataclasses of such.

    Raises:
        TypeError: something in them has contents that are not known.
    """
    digest = hashlib.sha256()
    _feed(digest.update, values)
    return digest.hexdigest()[:16]


def _feed(put: Callable[[bytes], None], value: Any) -> None:
    if is_dataclass(value) and not isinstance(value, type):
        put(f"{type(value).__qualname__}(".encode())
        for field in fields(value):
            put(f"{field.name}=".encode())
            _feed(put, getattr(value, field.name))
        put(b")")
    elif isinstance(value, tuple | list):
        put(f"[{len(value)}".encode())
        for entry in value:
            _feed(put, entry)
    elif isinstance(value, Mapping):
        _feed(put, list(value.items()))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        put(f"{value.shape}{value.dtype}".encode())
        put(np.ascontiguousarray(value).tobytes())
    elif value is None or isinstance(value, bool | int | float | str | np.generic):
        put(f"{type(value).__name__} {value!r};".encode())
    else:
        raise TypeError(f"the contents of a {type(value).__name__} are not known")


@cache
def code_identity() -> dict[str, str]:
    """Return versions of cosim, its engines, Python and processor family, and a hash of cosim's source."""
    digest = hashlib.sha256()
    folder = Path(__file__).resolve().parents[1]
    for path in sorted(folder.rglob("*.py")):
        digest.update(str(path.relative_to(folder)).encode())
        digest.update(path.read_bytes())
    return {
        "cosim": __version__,
        "source": digest.hexdigest()[:16],
        **{name: _version(name) for name in _ENGINES},
        "python": platform.python_version(),
        "processor": platform.machine(),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
