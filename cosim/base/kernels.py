"""Turns Python functions into kernels: numba compiles each for the one signature of its annotations, without
fast-math. A kernel is a pure function of arrays. Python calls it, and other kernels call it by its name. It
is compiled at its first call, see `cosim.base.compilation`, and its machine code is in a cache on disk, see
`cosim.base.kernel_cache`. A device function is compiled as a part of each kernel that calls it.
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

# Without fastmath NaN stays visible, and results do not depend on the optimisations of the compiler.
# With error_model="numpy" a division by zero gives inf, which is reported later, and loops stay vectorised.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_ANY_ORDER = {"reassoc", "contract"}


def _annotated(function: Any) -> Any:
    """Return the signature that a function's annotations give.

    Raises:
        TypeError: an argument or the result is not annotated with a type of `cosim.base.kernel_types`.
    """
    try:
        hints = {
            name: numba_type(kind) for name, kind in get_type_hints(function, include_extras=True).items()
        }
        code = function.__code__
        arguments = [hints[name] for name in code.co_varnames[: code.co_argcount]]
        return hints["return"](*arguments)
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
    """Return a decorator that turns a function into a kernel."""


def kernel(function: Any = None, *, reorder_sums: bool = False, allocates: bool = False) -> Any:
    """Turn a function into a kernel with the signature of its annotations, its `fixed_signature`.

    Args:
        function: if the decorator is used without arguments.
        reorder_sums: whether sums may be evaluated in any order, with fused multiply-add, as in BLAS; values
            that are not finite stay visible.
        allocates: whether the kernel makes arrays whose size is not known at compilation, returns arrays, or
            calls an allocating function. It then counts references, see `device_function` for the cost.
            `small_vector` makes arrays of known size without that.

    Raises:
        TypeError: it returns arrays without `allocates`, or an annotation is missing.
    """

    def decorate(function: Any) -> Any:
        fixed = _annotated(function)
        if not allocates and has_arrays(fixed.return_type):
            raise TypeError(f"a kernel of {fixed} returns arrays: it has to say that it allocates")
        options = _OPTIONS | counting(allocates=allocates)
        options["fastmath"] = _ANY_ORDER if reorder_sums else False  # not inherited from a calling kernel
        result: Any = numba.njit(function, **options)
        if KNOWN:
            result.__class__ = numba_insides.Kernel
            result.as_device_function = cache(partial(numba_insides.device_function, function, **options))
        result.fixed_signature, result.cache = fixed, cache_of(function)
        result.compile = partial(compilation.compile_called, result, result.compile)
        if result.cache is not None:
            result._cache = result.cache  # numba has no public way to set a cache
        return result

    return decorate if function is None else decorate(function)


def _device(function: Any, *, allocates: bool = False, **options: Any) -> Any:
    return numba_insides.device_function(function, **_OPTIONS, **options, **counting(allocates=allocates))


def device_function(function: Function) -> Function:
    """Mark a small function that only kernels call; it is compiled as a part of each of them.

    It makes no arrays and counts no references to arrays. Counting costs two atomic additions for every view
    of an array, more than many loops.
    """
    result: Function = _device(function)
    return result


def inlined(function: Function) -> Function:
    """Mark a device function that is inlined before any optimisation.

    For functions within a loop over SIMD lanes: a loop with calls that are inlined late is not vectorised.
    """
    result: Function = _device(function, forceinline=True)
    return result


def allocating(function: Function) -> Function:
    """Mark a device function that makes or returns arrays, or calls an allocating function."""
    result: Function = _device(function, allocates=True)
    return result


@cache
def unchecked(kernel: Function) -> Function:
    """Return the machine code of a kernel, which is called without a check of argument types.

    The check takes longer than the call: 6 us of 6.5 us with 30 arrays in named tuples. An argument of
    another type is misread, so the caller must have made all arguments.
    """
    dispatcher: Any = kernel
    compilation.compile_kernels((kernel,))
    dispatcher.compile(dispatcher.fixed_signature)  # or load it
    code: Function = dispatcher.overloads[tuple(dispatcher.fixed_signature.args)].entry_point
    return code


def unchecked_for(kernel: Function, *given: Any) -> Function:
    """Return `unchecked(kernel)` if these arguments have the annotated types, otherwise the kernel."""
    fixed = getattr(kernel, "fixed_signature", None)
    found = fixed is not None and tuple(map(numba.typeof, given)) == tuple(fixed.args)
    return unchecked(kernel) if found else kernel


def _small_array(dimensions: int, *, zeros: bool = False) -> Any:
    """Return a function that makes arrays of so many dimensions in a kernel."""
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
"""Makes an uninitialised array (length,) within a kernel; it exists until the kernel returns."""
small_matrix = _small_array(2)
"""Makes an uninitialised array (rows, columns) within a kernel, as `small_vector` does."""
zero_vector = _small_array(1, zeros=True)
"""Makes an array (length,) of zeros within a kernel, as `small_vector` does."""
zero_matrix = _small_array(2, zeros=True)
"""Makes an array (rows, columns) of zeros within a kernel, as `small_vector` does."""


@device_function
def copy(values: Vector, to: Vector) -> None:
    """Copy a vector; this loop compiles much faster than an assignment to a slice."""
    for i in range(values.shape[0]):
        to[i] = values[i]


@device_function
def copy_rows(values: Matrix, to: Matrix) -> None:
    """Copy the rows of a matrix with three columns."""
    for i in range(values.shape[0]):
        for r in range(3):
            to[i, r] = values[i, r]
