"""Functions that only kernels call, made callable; and where kernels are."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

import numba

import cosim


def compiled(function: Any) -> Callable[..., Any]:
    """Return what calls a device function with the given arguments from within a kernel."""

    def call(*arguments):  # type: ignore[no-untyped-def]
        return function(*arguments)

    result: Callable[..., Any] = numba.njit(call)
    return result


def all_modules() -> tuple[ModuleType, ...]:
    """Return every module of the package, imported."""
    found = (module.name for module in pkgutil.walk_packages(cosim.__path__, "cosim."))
    return tuple(import_module(name) for name in found if not name.endswith("__main__"))
