"""Small arrays of a kernel's own: on its stack, so that it asks for no memory and counts no references."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.cgutils import pack_array
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

_untyped: Any = intrinsic
_intrinsic: Callable[[Callable[..., Any]], Any] = _untyped(prefer_literal=True)
_ALIGNMENT = 32  # [bytes], of the widest loads


def _on_stack(lengths: tuple[Any, ...], *, zeros: bool = False) -> Any:
    """Return type and code of an array of literal lengths; None for other lengths."""
    if not all(isinstance(length, types.IntegerLiteral) for length in lengths):
        return None
    shape = [int(length.literal_value) for length in lengths]
    made = types.Array(types.float64, len(shape), "C")

    def generate(context: Any, builder: Any, _signature: Any, _given: Any) -> Any:
        count, strides = 1, list[int]()
        for length in reversed(shape):
            strides.insert(0, 8 * count)
            count *= length
        with builder.goto_entry_block():  # once, however often a loop comes by
            place = builder.alloca(ir.ArrayType(ir.DoubleType(), count))
            place.align = _ALIGNMENT
        if zeros:
            builder.store(ir.Constant(place.type.pointee, None), place)
        array = make_array(made)(context, builder)
        integer = context.get_value_type(types.intp)
        whole = [[ir.Constant(integer, value) for value in values] for values in (shape, strides)]
        populate_array(
            array, data=builder.bitcast(place, ir.DoubleType().as_pointer()),
            shape=pack_array(builder, whole[0]), strides=pack_array(builder, whole[1]),
            itemsize=ir.Constant(integer, 8), meminfo=None,
        )  # fmt: skip
        return array._getvalue()

    return made(*lengths), generate


@_intrinsic
def small_vector(_typing: Any, length: Any) -> Any:
    """Return an array (length,) of a kernel's own, not filled; it ends with the call in which it is made."""
    return _on_stack((length,))


@_intrinsic
def small_matrix(_typing: Any, rows: Any, columns: Any) -> Any:
    """Return an array (rows, columns) of a kernel's own, not filled; it ends as `small_vector` does."""
    return _on_stack((rows, columns))


@_intrinsic
def zero_vector(_typing: Any, length: Any) -> Any:
    """Return an array (length,) of zeros; it ends as `small_vector` does."""
    return _on_stack((length,), zeros=True)


@_intrinsic
def zero_matrix(_typing: Any, rows: Any, columns: Any) -> Any:
    """Return an array (rows, columns) of zeros; it ends as `small_vector` does."""
    return _on_stack((rows, columns), zeros=True)
