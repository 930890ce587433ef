"""How functions become kernels: one signature each, read from annotations, without fast-math.

A kernel is a pure function over arrays, called from Python, or by its name from another kernel. It is
compiled when it is first called, which is announced, see `cosim.base.compilation`; machine code stays on
disk, see `cosim.base.kernel_cache`. A device function is compiled as a part of each kernel that calls it.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar, get_type_hints, overload

import numba
import numpy as np
from numba.extending import intrinsic

from cosim.base import compilation, numba_insides
from cosim.base.kernel_cache import cache_of
from cosim.base.kernel_types import Matrix, Vector, numba_type
from cosim.base.numba_insides import KNOWN, counting, has_arrays, stack_array
from cosim.base.numba_insides import same_bits as same_bits

Function = TypeVar("Function", bound=Callable[..., Any])

# fastmath as a whole stays off: NaN must stay visible, and results must not depend on the compiler's mood.
# error_model="numpy" lets a division by zero give inf (a named outcome later) and keeps loops vectorised.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_ANY_ORDER = {"reassoc", "contract"}


def _annotated(function: Any) -> Any:
    """Return the signature that a function's annotations give.

    Raises:
        TypeError: an argument or what it returns is not annotated with a type of kernels.
    """
    try:
        hints = {
            name: numba_type(kind) for name, kind in get_type_hints(function, include_extras=True).items()
        }
        code = function.__code__
        given = [hints[name] for name in code.co_varnames[: code.co_argcount]]
        return hints["return"](*given)
    except KeyError as error:
        raise TypeError(f"{function.__qualname__}() does not annotate {error}") from None
    except TypeError as error:
        raise TypeError(f"{function.__qualname__}(): {error}") from None


@overload
def kernel(function: Function) -> Function:
    """Turn a function into a kernel."""


@overload
def kernel(
    function: None = None, *, reorder_sums: bool = ..., allocates: bool = ...
) -> Callable[[Function], Function]:
    """Return what turns a function into a kernel."""


def kernel(function: Any = None, *, reorder_sums: bool = False, allocates: bool = False) -> Any:
    """Turn a function into a kernel with the signature of its annotations, kept as `fixed_signature`.

    Args:
        function: decorated without arguments.
        reorder_sums: whether sums may be taken in any order, with products fused into them, as BLAS does;
            values that are not finite stay visible.
        allocates: whether it makes arrays whose size it does not know when it is compiled, returns arrays, or
            calls what does; see `device_function` for what that costs, and `small_vector` for the others.

    Raises:
        TypeError: it returns arrays, and does not say that it allocates; or an annotation is missing.
    """

    def decorate(function: Any) -> Any:
        fixed = _annotated(function)
        if not allocates and has_arrays(fixed.return_type):
            raise TypeError(f"a kernel of {fixed} returns arrays: it has to say that it allocates")
        options = _OPTIONS | counting(allocates=allocates)
        options["fastmath"] = _ANY_ORDER if reorder_sums else False  # not that of a kernel that calls it
        result: Any = numba.njit(function, **options)
        if KNOWN:
            result.__class__ = numba_insides.Kernel
            result.taken_in = cache(partial(numba_insides.device_function, function, **options))
        result.fixed_signature, result.cache = fixed, cache_of(function)
        result.compile = partial(compilation.compile_called, result, result.compile)
        if result.cache is not None:
            result._cache = result.cache  # numba has no public way to say what else a kernel depends on
        return result

    return decorate if function is None else decorate(function)


def _device(function: Any, *, allocates: bool = False, **options: Any) -> Any:
    return numba_insides.device_function(function, **_OPTIONS, **options, **counting(allocates=allocates))


def device_function(function: Function) -> Function:
    """Mark a small function that kernels call; it is compiled with each of them, and for nothing else.

    It makes no arrays, and counts no references to those that it is given: every view of one costs two
    atomic additions otherwise, more than many a loop does.
    """
    result: Function = _device(function)
    return result


def inlined(function: Function) -> Function:
    """Mark a device function that becomes part of its callers before anything is optimised.

    For what a loop over lanes calls: with calls in it that are inlined late, the loop is not vectorised.
    """
    result: Function = _device(function, forceinline=True)
    return result


def allocating(function: Function) -> Function:
    """Mark a device function that makes arrays, hands its own arrays on, or calls what does."""
    result: Function = _device(function, allocates=True)
    return result


@cache
def unchecked(kernel: Function) -> Function:
    """Return the code of a kernel, which does not look at the types of what it is given.

    That look takes longer than the call: 6 us of 6.5 with 30 arrays in named tuples. Whatever is not of the
    annotated types is misread, so it is for arrays that the caller has made.
    """
    asked: Any = kernel
    compilation.compile_kernels((kernel,))
    asked.compile(asked.fixed_signature)  # or load it
    found: Function = asked.overloads[tuple(asked.fixed_signature.args)].entry_point
    return found


def for_these(kernel: Function, *given: Any) -> Function:
    """Return `unchecked(kernel)` if these arguments have the annotated types, otherwise the kernel."""
    fixed = getattr(kernel, "fixed_signature", None)
    found = fixed is not None and tuple(map(numba.typeof, given)) == tuple(fixed.args)
    return unchecked(kernel) if found else kernel


def _small_array(dimensions: int, *, zeros: bool = False) -> Any:
    """Return what makes arrays of so many lengths in a kernel."""
    if KNOWN:
        define: Any = (
            (lambda _typing, length: stack_array((length,), zeros=zeros))
            if dimensions == 1
            else (lambda _typing, rows, columns: stack_array((rows, columns), zeros=zeros))
        )
        untyped: Any = intrinsic
        return untyped(prefer_literal=True)(define)
    make = np.zeros if zeros else np.empty
    return numba.njit((lambda n: make(n)) if dimensions == 1 else (lambda n, m: make((n, m))))


small_vector = _small_array(1)
"""Makes an array (length,) of a kernel's own, not filled; it ends with the call in which it is made."""
small_matrix = _small_array(2)
"""Makes an array (rows, columns) of a kernel's own, not filled; it ends as `small_vector` does."""
zero_vector = _small_array(1, zeros=True)
"""Makes an array (length,) of zeros; it ends as `small_vector` does."""
zero_matrix = _small_array(2, zeros=True)
"""Makes an array (rows, columns) of zeros; it ends as `small_vector` does."""


@device_function
def copy(values: Vector, to: Vector) -> None:
    """Copy values; a loop compiles in a fraction of the time of an assignment to a slice."""
    for i in range(values.shape[0]):
        to[i] = values[i]


@device_function
def copy_rows(values: Matrix, to: Matrix) -> None:
    """Copy the rows of a matrix with three columns."""
    for i in range(values.shape[0]):
        for r in range(3):
            to[i, r] = values[i, r]
