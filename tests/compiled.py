"""Functions that only kernels call, made callable."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(function: Any) -> Callable[..., Any]:
    """Return what calls a device function with the given arguments from within a kernel."""

    def call(*arguments):  # type: ignore[no-untyped-def]
        return function(*arguments)

    result: Callable[..., Any] = numba.njit(call)
    return result
