"""Compiler settings for kernels, and all uses of private modules of numba. Kernels count no references, and
device functions are compiled only with the kernels that call them. A version of numba other than `KNOWN` uses
public functions alone: compilation takes half as long again, and results are the same up to rounding.
"""

import pickle
from functools import partial
from types import SimpleNamespace
from typing import Any, Final, NoReturn, final

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

KNOWN: Final = str(numba.__version__).startswith("0.68.")  # its insides are as the code below expects
_intrinsic: Any = intrinsic  # typed for mypy


def has_arrays(kind: Any) -> bool:
    """Return whether a type of numba is an array, or a tuple with arrays in it."""
    return isinstance(kind, numba.types.Array) or any(map(has_arrays, getattr(kind, "types", ())))


def counting(*, allocates: bool) -> dict[str, Any]:
    """Return compiler options that count references, two atomic additions for each view, only if needed."""
    return {"_nrt": allocates, "no_cfunc_wrapper": True} if KNOWN else {}


def to_bytes(compiled: Any) -> bytes | None:
    """Return the bytes of a compiled kernel for the cache; None if it contains addresses of this process."""
    from numba.core.serialize import dumps

    if compiled.library.has_dynamic_globals:
        return None
    if KNOWN:  # no other code is linked with it, so intermediate code would only make reading slower
        names = sorted(entry.name for entry in compiled.library.get_defined_functions())
        empty = "".join(f'define void @"{name}"() {{ ret void }}\n' for name in names)
        compiled.library._shared_module = llvm.parse_assembly(empty)
    return bytes(dumps(compiled._reduce()))


def prepare_to_load(context: Any) -> None:
    """Prepare a target context of numba for code from the cache, which needs none of what compilation needs.

    That takes a third of a second to load.
    """
    if KNOWN:
        rtsys.initialize(context)  # the functions that the code calls for its arguments
    else:
        context.refresh()


def from_bytes(data: bytes, context: Any) -> Any:
    """Return the compiled code of `to_bytes` in a target context of numba."""
    from numba.core.compiler import CompileResult

    return CompileResult._rebuild(context, *pickle.loads(data))


if KNOWN:
    from numba.core.cgutils import pack_array
    from numba.core.codegen import CPUCodeLibrary
    from numba.core.compiler import Compiler
    from numba.core.registry import CPUDispatcher
    from numba.core.runtime.nrt import rtsys
    from numba.np.arrayobj import make_array, populate_array

    @final
    class IntermediateCode(CPUCodeLibrary):
        """Code of a function that is optimised with each kernel that calls it."""

        codegen = SimpleNamespace(set_env=lambda *_arguments: None)  # no machine code, so no environment

        def _optimize_final_module(self) -> None: ...

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._finalized = True

        def get_pointer_to_function(self, name: str) -> int:
            return 0  # there is no machine code

    @final
    class DeviceCompiler(Compiler):
        """Compiles a function to `IntermediateCode`."""

        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            self.state.library = IntermediateCode(self.state.targetctx.codegen(), "device_function")

    @final
    class DeviceFunction(CPUDispatcher):
        """A function that only kernels can call."""

        def __call__(self, *_given: Any) -> NoReturn:
            raise TypeError(f"only kernels can call {self.py_func.__name__}(), which has no code of its own")

        def compile(self, signature: Any) -> Any:
            """Compile; numba refuses to return an uncounted array by itself, but not in a tuple."""
            found: Any = super().compile(signature)
            returned = any(has_arrays(entry.return_type) for entry in self.nopython_signatures)
            if returned and not self.targetoptions["_nrt"]:
                raise TypeError(f"{self.py_func.__name__}() returns arrays: mark it as allocating")
            return found

    @final
    class Kernel(CPUDispatcher):
        """A function that Python calls; in a kernel that calls it by name it is a device function."""

        as_device_function: Any

        @property
        def _numba_type_(self) -> Any:
            return numba.types.Dispatcher(self.as_device_function())


def device_function(function: Any, **options: Any) -> Any:
    """Return a dispatcher that compiles a function as a part of every kernel that calls it."""
    if not KNOWN:
        return numba.njit(function, **options)
    compile_later: Any = numba.njit  # typed for its public options
    found: Any = compile_later(function, **options, no_cpython_wrapper=True, pipeline_class=DeviceCompiler)
    found.__class__ = DeviceFunction  # numba makes dispatchers of one class alone
    return found


@_intrinsic  # type: ignore[untyped-decorator]
def same_bits(_typing: Any, value: Any) -> Any:
    """Return the uint64 with the bits of a real number, or the reverse; loops over lanes stay vectorised."""
    kind = numba.types.uint64 if isinstance(value, numba.types.Float) else numba.types.float64

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], context.get_value_type(kind))

    return kind(value), generate


def stack_array(asked: tuple[Any, ...], *, zeros: bool = False) -> Any:
    """Return type and code of an array on a kernel's stack, without references; None if its size varies."""
    shape = [int(length.literal_value) for length in asked if isinstance(length, numba.types.IntegerLiteral)]
    if len(shape) < len(asked):
        return None
    made = numba.types.Array(numba.types.float64, len(shape), "C")

    def generate(context: Any, builder: Any, _signature: Any, _given: Any) -> Any:
        with builder.goto_entry_block():  # allocated once, also within a loop
            place = builder.alloca(ir.ArrayType(ir.DoubleType(), int(np.prod(shape))))
            place.align = 32  # [bytes], of the widest loads
        if zeros:
            builder.store(ir.Constant(place.type.pointee, None), place)
        array, integer = make_array(made)(context, builder), context.get_value_type(numba.types.intp)
        strides = [8 * int(np.prod(shape[k + 1 :])) for k in range(len(shape))]
        number = partial(ir.Constant, integer)
        lengths, steps = (pack_array(builder, [*map(number, ks)]) for ks in (shape, strides))
        data, item = builder.bitcast(place, ir.DoubleType().as_pointer()), number(8)
        populate_array(array, data=data, shape=lengths, strides=steps, itemsize=item, meminfo=None)
        return array._getvalue()

    return made(*asked), generate
