"""Types of the arguments of kernels, for annotations: numbers, arrays, and named tuples of these. Records
import only this module, so that they do not import the compiler of `cosim.base.kernels`.
"""

from functools import cache
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

Vector: TypeAlias = Annotated[NDArray[np.float64], numba.float64[::1]]
Singles: TypeAlias = Annotated[NDArray[np.float32], numba.float32[::1]]
Matrix: TypeAlias = Annotated[NDArray[np.float64], numba.float64[:, ::1]]
Blocks: TypeAlias = Annotated[NDArray[np.float64], numba.float64[:, :, ::1]]
Cubes: TypeAlias = Annotated[NDArray[np.float64], numba.float64[:, :, :, ::1]]
Indices: TypeAlias = Annotated[NDArray[np.int64], numba.int64[::1]]
IndexTable: TypeAlias = Annotated[NDArray[np.int64], numba.int64[:, ::1]]
Places: TypeAlias = Annotated[NDArray[np.uint64], numba.uint64[::1]]
PlaceTable: TypeAlias = Annotated[NDArray[np.uint64], numba.uint64[:, ::1]]
Flags: TypeAlias = Annotated[NDArray[np.bool_], numba.boolean[::1]]
Masks: TypeAlias = Annotated[NDArray[np.bool_], numba.boolean[:, ::1]]

VECTOR, MATRIX, BLOCKS = numba.float64[::1], numba.float64[:, ::1], numba.float64[:, :, ::1]
INDICES, INDEX_TABLE = numba.int64[::1], numba.int64[:, ::1]
"""The same for annotations that name sizes as well: `Annotated[Array, ("k",), VECTOR]`."""

_PLAIN: dict[Any, Any] = {
    float: types.float64, int: types.int64, bool: types.boolean, type(None): types.void,
}  # fmt: skip


@cache
def numba_type(kind: Any) -> Any:
    """Return numba's type for an annotation.

    Args:
        kind: float, int, bool, None, an alias such as `Matrix` that carries its type, or a tuple or named
            tuple of these; the address of a kernel is an int.

    Raises:
        TypeError: it is anything else.
    """
    if kind in _PLAIN:
        return _PLAIN[kind]
    if get_origin(kind) is Annotated:
        carried = [entry for entry in get_args(kind)[1:] if isinstance(entry, types.Type)]
        if len(carried) == 1:
            return carried[0]
    if get_origin(kind) is tuple:
        return types.Tuple(tuple(map(numba_type, get_args(kind))))
    if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
        fields = get_type_hints(kind, include_extras=True)
        parts = tuple(numba_type(fields[name]) for name in kind._fields)
        alike = len(set(parts)) == 1  # numba has another type for such tuples
        return types.NamedUniTuple(parts[0], len(parts), kind) if alike else types.NamedTuple(parts, kind)
    raise TypeError(
        f"{kind}: no type of an argument of kernels; annotate it with an alias of cosim.base.kernel_types"
    )


def empty_of(kind: Any) -> Any:
    """Return a value of a type with empty arrays and zeros, for an unused argument of a kernel."""
    kind = kind if isinstance(kind, types.Type) else numba_type(kind)
    if isinstance(kind, types.NamedTuple | types.NamedUniTuple):
        return kind.instance_class(*map(empty_of, kind.types))
    if isinstance(kind, types.Array):
        return np.zeros((0,) * kind.ndim, str(kind.dtype))
    return False if kind == types.boolean else kind.cast_python_value(0)
