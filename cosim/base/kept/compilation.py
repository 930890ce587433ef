"""Compiles kernels that are not on disk yet, and says so beforehand."""

from __future__ import annotations

import os
from collections.abc import Callable
from types import ModuleType
from typing import Any

from cosim.base.kept.kernel_cache import remove_old
from cosim.base.kept.seldom_collecting import seldom_collecting
from cosim.base.kept.side_by_side import compile_side_by_side, processes

_SECONDS_EACH = 1.1  # of processor time, in the mean


def compile_modules(announce: Callable[[str], None], modules: tuple[ModuleType, ...]) -> None:
    """Compile the kernels of modules, not those that they import, or load them.

    Args:
        announce: told in one sentence, before the wait, when they have to be compiled.
        modules: that hold them.
    """
    found: dict[int, Any] = {
        id(value): value
        for module in modules
        for value in vars(module).values()
        if getattr(value, "fixed_signature", None) is not None and value.__module__ == module.__name__
    }
    kernels = [kernel for kernel in found.values() if not kernel.overloads]
    missing = [kernel for kernel in kernels if not _is_on_disk(kernel)]
    with seldom_collecting():
        if missing:
            announce(_sentence(len(missing)))
            compile_side_by_side(missing)
        for kernel in kernels:
            kernel.compile(kernel.fixed_signature)
    if missing:
        remove_old(kernels)


def _sentence(kernels: int) -> str:
    tens_of_s = max(1, round(0.1 * _SECONDS_EACH * kernels / processes()))
    return (
        f"Compiling {kernels} kernels: the first run on a machine takes some {10 * tens_of_s} s longer, on a "
        "busy one twice that; the result is kept for later runs."
    )


def _is_on_disk(kernel: Any) -> bool:
    """Return whether a kernel seems to be on disk."""
    place = getattr(kernel._cache, "_cache_file", None)
    return place is not None and os.path.exists(place._index_path)
