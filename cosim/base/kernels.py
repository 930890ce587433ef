"""How the numba kernels are compiled: for one fixed signature each, cached on disk, without fast-math.

Importing a kernel compiles nothing; `compile_kernels` in compilation.py does, once, and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from cosim.base.kernel_cache import keep_by_source

Function = TypeVar("Function", bound=Callable[..., Any])

# fastmath as a whole stays off: NaN must stay visible, and results must not depend on the compiler's mood.
# error_model="numpy" lets a division by zero give inf (a named outcome later) and keeps loops vectorised.
_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}

REAL = numba.float64
BOOLEAN = numba.boolean
INTEGER = numba.int64
VECTOR = numba.float64[::1]
MATRIX = numba.float64[:, ::1]
BLOCKS = numba.float64[:, :, ::1]
CUBES = numba.float64[:, :, :, ::1]
INDICES = numba.int64[::1]
PLACES = numba.uint64[::1]
INDEX_TABLE = numba.int64[:, ::1]
PLACE_TABLE = numba.uint64[:, ::1]
MASKS = numba.boolean[:, ::1]


def kernel(signature: Any, *, reorder_sums: bool = False) -> Callable[[Function], Function]:
    """Return a decorator that turns a function into a kernel with one fixed signature.

    Args:
        signature: numba signature, kept as `fixed_signature` for `compile_kernels`.
        reorder_sums: whether sums may be taken in any order, with products fused into them, as BLAS does;
            values that are not finite stay visible.
    """

    def decorate(function: Function) -> Function:
        fast: dict[str, Any] = {"fastmath": {"reassoc", "contract"}} if reorder_sums else {}
        dispatcher = _compiled_later(function, **fast)
        dispatcher.fixed_signature = signature
        result: Function = dispatcher
        return result

    return decorate


def inlined(function: Function) -> Function:
    """Mark a small function that kernels call; it is compiled with each of them."""
    result: Function = _compiled_later(function, inline="never")
    return result


def _compiled_later(function: Any, **options: Any) -> Any:
    """Return what compiles a function when it is called, and keeps the machine code where it can be."""
    try:
        dispatcher = numba.njit(function, **_OPTIONS, **options)
    except RuntimeError:  # no place for a cache: neither beside the source nor in the user's directory
        return numba.njit(function, **(_OPTIONS | options | {"cache": False}))
    keep_by_source(dispatcher)
    return dispatcher
