"""Kernels that call others by their addresses: each is compiled once, and only where it is needed.

A kernel that is called by name is compiled again as a part of the one that calls it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.cgutils import unpack_tuple
from numba.extending import intrinsic


@cache
def address_of(kernel: Any) -> int:
    """Return where a kernel's machine code is, compiled or loaded if need be; it stays there."""
    signature = kernel.fixed_signature
    kernel.compile(signature)
    compiled = kernel.overloads[_arguments(signature)]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def caller(kernel: Any) -> Any:
    """Return what calls a kernel from within others: call(address, arguments), with a tuple of arguments.

    Args:
        kernel: or another of the same signature; none of them raises.
    """
    signature = kernel.fixed_signature
    wanted, returned = types.Tuple(_arguments(signature)), signature.return_type

    def call(_typing: Any, address: Any, given: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            convention = context.call_conv
            code = convention.get_function_type(returned, wanted.types)
            function = builder.inttoptr(values[0], ir.PointerType(code))
            pairs = zip(unpack_tuple(builder, values[1]), given.types, wanted.types, strict=True)
            cast = [context.cast(builder, value, from_, to) for value, from_, to in pairs]
            _, result = convention.call_function(builder, function, returned, wanted.types, cast)
            return result

        return returned(types.int64, given), generate

    return intrinsic(call)


def nothing_of(kind: Any) -> Any:
    """Return arrays without entries, and zeros, that stand for nothing where a kernel takes some type."""
    if isinstance(kind, types.NamedTuple):
        return kind.instance_class(*map(nothing_of, kind.types))
    if isinstance(kind, types.Array):
        return np.zeros((0,) * kind.ndim, str(kind.dtype))
    return False if kind == types.boolean else kind.cast_python_value(0)


def _arguments(signature: Any) -> tuple[Any, ...]:
    return tuple(signature.args)
