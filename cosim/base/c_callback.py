"""Compiles a function for C, for callbacks of a library such as MuJoCo. It runs without Python's lock and
cannot raise. It gets arrays as addresses, which `numbers_at` and `reals_at` read; the caller keeps a
reference to each array as long as C may call the function.
"""

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_intrinsic: Callable[..., Any] = intrinsic  # typed for mypy


def _pointer(kind: Any) -> Any:
    """Return an intrinsic that converts an address to a pointer to numbers of a kind."""

    def define(_typing: Any, _address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return builder.inttoptr(values[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), generate

    return _intrinsic(define)


numbers_at = _pointer(types.int64)
"""Reads, in compiled code, an array of int64 at its address."""
reals_at = _pointer(types.float64)
"""Reads, in compiled code, an array of float64 at its address."""


@_intrinsic
def call_c(_typing: Any, _code: Any, _first: Any, _second: Any) -> Any:
    """Call, in compiled code, a C function of two pointers by its address."""

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        code = ir.FunctionType(ir.VoidType(), [value.type for value in values[1:]])  # pointers as integers
        builder.call(builder.inttoptr(values[0], code.as_pointer()), values[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


def c_function(function: Callable[[int, int], None]) -> Any:
    """Compile a function of two pointers for C; the result has its `address`."""
    return numba.cfunc(types.void(types.int64, types.int64))(function)
