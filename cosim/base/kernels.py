"""How functions become numba kernels: one signature each, read from their annotations, without fast-math.

Importing a kernel compiles nothing: `compile_modules` does, once, and says so. So does the first call of a
kernel that was not compiled beforehand.

A device function is compiled as a part of each kernel that calls it. Kernels call one another by address:
each is compiled once, and only where it is needed.

Machine code is kept under a hash of all source that it comes from, see `cosim.base.caches`.
"""

import _thread
import logging
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from ctypes import addressof, c_char, c_int64
from functools import cache
from hashlib import sha256
from pathlib import Path
from struct import Struct
from typing import Any, TypeVar, final, get_type_hints, overload

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from cosim.base import caches, compilation, numba_insides
from cosim.base.kernel_types import Matrix, Vector, numba_type
from cosim.base.numba_insides import KNOWN, from_bytes, has_arrays, processor, stack_array, to_bytes
from cosim.base.numba_insides import call_native as call_native
from cosim.base.numba_insides import caller as caller
from cosim.base.numba_insides import number_at as number_at
from cosim.base.numba_insides import same_bits as same_bits

Function = TypeVar("Function", bound=Callable[..., Any])
Record = TypeVar("Record")

# fastmath as a whole stays off: NaN must stay visible, and results must not depend on the compiler's mood.
# error_model="numpy" lets a division by zero give inf (a named outcome later) and keeps loops vectorised.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORT = re.compile(r"^\s*(?:from|import) (\.*)([\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)


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


@final
class KernelCache:
    """Keeps a kernel's machine code: numba asks it before it compiles, and hands it what it has compiled.

    `keeps` says whether anything can be written.

    Args:
        function: of the kernel, in a file.
        alone: whether no other kernel calls it by name.
    """

    def __init__(self, function: Any, *, alone: bool) -> None:
        self._base, self._alone = f"{function.__module__}.{function.__qualname__}", alone
        self._source = source_hash(Path(function.__code__.co_filename).resolve())
        folder = caches.folders(caches.KERNELS)[0]
        self.keeps, self.cache_path = folder is not None, str(folder)

    def name(self, signature: Any) -> str:
        """Return the name of the file for a signature, or a tuple of argument types."""
        digest = sha256(f"{self._source} {signature} {self._alone}".encode()).hexdigest()[:12]
        return f"{self._base}-{digest}.nbc"

    def is_there(self, signature: Any) -> bool:
        """Return whether there is sound machine code."""
        return bool(caches.kept(caches.KERNELS, self.name(signature), bool))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what is kept for a signature; None if there is nothing."""
        context.refresh()
        return caches.kept(caches.KERNELS, self.name(signature), lambda data: from_bytes(data, context))

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled, where it can be."""
        if not self.keeps:
            return
        with suppress(*(() if KNOWN else (Exception,))):  # another numba may keep other things
            data = to_bytes(compiled, alone=self._alone)
            if data is not None:
                caches.keep(caches.KERNELS, self.name(signature), data)


def cache_of(function: Any, *, alone: bool) -> KernelCache | None:
    """Return the cache of a kernel; None where no folder can be used, or its code is not all in files."""
    in_file = os.path.isfile(function.__code__.co_filename) and not function.__closure__
    return KernelCache(function, alone=alone) if in_file and any(caches.folders(caches.KERNELS)) else None


@cache
def source_hash(path: Path) -> str:
    """Return a hash of a file, of those that it imports from cosim or its package, and of the compiler."""
    settings = sorted(entry for entry in os.environ.items() if entry[0].startswith("NUMBA_"))
    chosen = [entry for entry in settings if entry[0] not in ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")]
    versions = numba.__version__, np.__version__, sys.version_info[:2]
    digest, found, to_do = sha256(f"{versions} {KNOWN} {processor()} {chosen}".encode()), {path}, [path]
    while to_do:
        for imported in _imports(to_do.pop()) - found:
            found.add(imported)
            to_do.append(imported)
    for entry in sorted(found):
        digest.update(_text(entry).encode())
    return digest.hexdigest()[:12]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Return the files that a file imports from cosim, from its own package, or from beside it."""
    top, found = path, set()
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    for dots, module, names in _IMPORT.findall(_text(path)):
        first = module.partition(".")[0]
        if dots:
            root = path.parents[len(dots) - 1]
        elif first == _PACKAGE.name:
            root = _PACKAGE.parent
        elif first == top.stem or (top == path and (top.parent / f"{first}.py").is_file()):
            root = top.parent
        else:
            continue
        folder = root.joinpath(*filter(None, module.split(".")))
        for name in ("", *re.findall(r"\w+", names)):
            candidate = (folder / name if name else folder).with_suffix(".py")
            if candidate.is_file():
                found.add(candidate)
    return frozenset(found)


@overload
def kernel(function: Function) -> Function:
    """Turn a function into a kernel."""


@overload
def kernel(
    function: None = None,
    *,
    reorder_sums: bool = ...,
    allocates: bool = ...,
    taken_in: bool = ...,
    for_c: bool = ...,
) -> Callable[[Function], Function]:
    """Return what turns a function into a kernel."""


def kernel(
    function: Any = None,
    *,
    reorder_sums: bool = False,
    allocates: bool = False,
    taken_in: bool = False,
    for_c: bool = False,
) -> Any:
    """Turn a function into a kernel with the signature of its annotations, kept as `fixed_signature`.

    Args:
        function: decorated without arguments.
        reorder_sums: whether sums may be taken in any order, with products fused into them, as BLAS does;
            values that are not finite stay visible.
        allocates: whether it makes arrays whose size it does not know when it is compiled, returns arrays, or
            calls what does; see `device_function` for what that costs, and `small_vector` for the others.
        taken_in: whether other kernels call it by its name, each of which compiles it as its own part.
        for_c: whether C may call it as well, see `c_address`; it must not raise.

    Raises:
        TypeError: it returns arrays, and does not say that it allocates; or an annotation is missing.
    """

    def decorate(function: Any) -> Any:
        fixed = _annotated(function)
        if not allocates and has_arrays(fixed.return_type):
            raise TypeError(f"a kernel of {fixed} returns arrays: it has to say that it allocates")
        options = dict(_OPTIONS, fastmath={"reassoc", "contract"}) if reorder_sums else dict(_OPTIONS)
        if KNOWN:
            options |= {"_nrt": allocates, "no_cfunc_wrapper": not for_c}
        result: Any = numba.njit(function, **options)
        result.by_address = KNOWN and not taken_in
        if result.by_address:
            result.__class__ = numba_insides.Kernel
        result.fixed_signature, result.cache = fixed, cache_of(function, alone=result.by_address)
        # a first call asks for its types of arguments alone: a second copy, kept in another file
        compile_as = result.compile
        result.compile = lambda asked: compile_as(fixed if asked == fixed.args else asked)
        if result.cache is not None:
            result._cache = result.cache  # numba has no public way to say what else a kernel depends on
        return result

    return decorate if function is None else decorate(function)


def _device(function: Any, *, allocates: bool = False, **options: Any) -> Any:
    """Return what compiles a function as a part of every kernel that calls it."""
    options |= _OPTIONS
    if not KNOWN:
        return numba.njit(function, **options)
    compile_later: Any = numba.njit  # typed for its public options
    flags = {
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
        "pipeline_class": numba_insides.DeviceCompiler,
    }
    found: Any = compile_later(function, **options, **flags, _nrt=allocates)
    found.__class__ = numba_insides.DeviceFunction  # numba makes dispatchers of one class alone
    return found


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


def handing_on_views(function: Function) -> Function:
    """Mark a device function that hands on, in named tuples, views of arrays that it is given.

    It makes no arrays, and counts no references: only what counts none either can call it.
    """
    result: Any = _device(function)
    result.hands_on_views = True
    found: Function = result
    return found


@cache
def address_of(kernel: Any) -> int:
    """Return the place of a kernel, by which others call it, see `caller`: it need not be compiled yet."""
    place = c_int64(0)
    _PLACES[addressof(place)] = kernel, place
    return addressof(place)


def c_address(kernel: Any) -> int:
    """Return the address at which C calls a kernel that was made for it; it is compiled if need be."""
    compilation.compile_modules(logging.getLogger("cosim").warning, (kernel,))
    return numba_insides.code_for_c(kernel, kernel.fixed_signature)


@cache
def unchecked(kernel: Function) -> Function:
    """Return the code of a kernel, which does not look at the types of what it is given.

    That look takes longer than the call: 6 us of 6.5 with 30 arrays in named tuples. Whatever is not of the
    annotated types is misread, so it is for arrays that the caller has made.
    """
    asked: Any = kernel
    compilation.compile_modules(logging.getLogger("cosim").warning, (kernel,))
    found: Function = asked.overloads[tuple(asked.fixed_signature.args)].entry_point
    return found


def _code_at(at: int) -> int:
    """Return where the code of the kernel of a place is, and keep it there; 0 if it cannot be compiled.

    With it the other kernels of its module are compiled, which is announced as before a run.
    """
    kernel, place = _PLACES[at]
    signature, log = kernel.fixed_signature, logging.getLogger("cosim")
    try:
        if not kernel.overloads:
            compilation.compile_modules(log.warning, (sys.modules[kernel.__module__],))
        kernel.compile(signature)
        compiled = kernel.overloads[tuple(signature.args)]
        place.value = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    except KeyboardInterrupt:
        _thread.interrupt_main()  # raised where compiled code ends, as it cannot be within
    except Exception:
        log.exception("%s() could not be compiled", kernel.__name__)
    return place.value


_PLACES: dict[int, tuple[Any, c_int64]] = {}
_FINDS = numba_insides.find_kernels_by(_code_at)


@final
class RecordStore:
    """Keeps a record where kernels read it by its address, see `record_at`: as 8 bytes for each number.

    Args:
        kind: named tuple of what kernels take.
    """

    def __init__(self, kind: Any) -> None:
        self._layout = _layout(numba_type(kind))
        self._words, self._last = np.zeros(self._layout[0], np.int64), None

    def address(self, record: Any) -> int:
        """Return where a record is until the next one is given; only what has changed is written.

        Raises:
            TypeError: an array in it is none that the kernels take.
        """
        last, self._last = self._last, None
        self._write(self._layout, record, last, 0)
        self._last = record  # so that its arrays stay
        return int(self._words.ctypes.data)

    def _write(self, layout: Any, given: Any, last: Any, begin: int) -> None:
        if given is last:
            return
        _, kind, parts = layout
        if parts is not None:
            earlier = (None,) * len(parts) if last is None else last
            for part, value, before in zip(parts, given, earlier, strict=True):
                if value is not before:
                    self._write(part, value, before, begin)
                begin += part[0]
        elif kind == "float64":
            self._words.view(np.float64)[begin] = given
        elif kind is None:
            self._words[begin] = given
        elif given.dtype != kind[0] or given.ndim != kind[1] or not (given.flags.c_contiguous or kind[3]):
            raise TypeError(f"an array of {given.dtype} {given.shape} is none of {kind[:2]}")
        else:
            # read-only arrays, or with gaps, have no buffer for ctypes; numpy's way takes six times as long
            place = 0
            if given.size:
                writable = given.flags.writeable and given.flags.c_contiguous
                place = addressof(c_char.from_buffer(given)) if writable else given.ctypes.data
            numbers = given.size, given.itemsize, place, *given.shape, *given.strides
            # the first two words are its owner, which none asks for
            kind[2](self._words, 8 * (begin + 2), *numbers)


def _layout(kind: Any) -> tuple[int, Any, Any]:
    """Return words, type of a number or of the entries of an array, and the parts of a tuple."""
    words = numba_insides.words_of(kind)
    if isinstance(kind, numba_insides.BASE_TUPLE):
        return words, None, [_layout(part) for part in kind.types]
    if isinstance(kind, types.Array):
        dtype = np.dtype("bool" if kind.dtype == types.boolean else str(kind.dtype))
        return words, (dtype, kind.ndim, Struct(f"{words - 2}q").pack_into, kind.layout == "A"), None
    return words, "float64" if kind == types.float64 else None, None


@numba_insides.untyped_intrinsic
def _record_at(_typing: Any, address: Any, kind: Any) -> Any:
    return numba_insides.reference(address, kind, numba_type(kind.instance_class))


record_at: Callable[[int, type[Record]], Record] = _record_at
"""Reads, in a kernel, the record of some kind at an address of `RecordStore`; it is not copied."""


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
