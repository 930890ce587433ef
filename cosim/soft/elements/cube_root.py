"""A start for cube roots that loops over lanes can vectorise, which calls of a library's function are not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_untyped: Any = intrinsic
_intrinsic: Callable[[Callable[..., Any]], Any] = _untyped
_THIRD: Final = 0x55555556  # of 2^32, rounded up
_BIAS: Final = 715094163  # two thirds of the exponent's bias, less what makes the largest error least
_HALF_BITS: Final = 32


@_intrinsic
def rough_cube_root(_typing: Any, value: Any) -> Any:
    """Return the cube root of a positive number within 5 %: a third of its upper bits, and a bias.

    Source: a common start, e.g. cbrt of W. Kahan and K. C. Ng, in FreeBSD's msun.
    """

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        integer, half = ir.IntType(64), ir.Constant(ir.IntType(64), _HALF_BITS)
        upper = builder.lshr(builder.bitcast(given[0], integer), half)
        third = builder.lshr(builder.mul(upper, ir.Constant(integer, _THIRD)), half)
        root = builder.shl(builder.add(third, ir.Constant(integer, _BIAS)), half)
        return builder.bitcast(root, ir.DoubleType())

    return types.float64(types.float64), generate
