"""How the numba kernels are compiled: for one fixed signature each, cached on disk, without fast-math.

Importing a kernel compiles nothing; `compile_kernels` in compilation.py does, once, and says so.

A device function is compiled to intermediate code alone: numba would optimise it by itself, make machine code
of it and a way to call it from Python, and keep that on disk; the compilation of each kernel that calls it
then does the same again.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NoReturn, TypeVar, final

import llvmlite.binding as llvm
import numba
from numba.core.caching import CompileResultCacheImpl, IndexDataCacheFile
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack

_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORT = re.compile(r"^\s*(?:from|import) cosim\.?([\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)
_KNOWN = "0.68."  # numba whose insides are as `IntermediateCode`, `DeviceCompiler` and `Kernel` take them


@final
class _MachineCode(CompileResultCacheImpl):
    """Keeps no intermediate code: kernels that call one by name take it in, and it takes longest to load."""

    def reduce(self, compiled: Any) -> Any:
        """Return what is kept of a kernel; of its functions numba asks for the names."""
        names = sorted(entry.name for entry in compiled.library.get_defined_functions())
        empty = "".join(f'define void @"{name}"() {{ ret void }}\n' for name in names)
        compiled.library._shared_module = llvm.parse_assembly(empty)
        return super().reduce(compiled)


def keep_by_source(dispatcher: Any, *, alone: bool) -> None:
    """Let a cached kernel be kept, where numba keeps it, under the hash of its source.

    Args:
        dispatcher: of a function of cosim, declared with `cache=True`.
        alone: whether to keep machine code alone; no other kernel may call it by its name then.
    """
    kept = dispatcher._cache  # numba has no public way to say what else a kernel depends on
    if alone:
        kept._impl = _MachineCode(dispatcher.py_func)
    place, path = kept._impl, Path(dispatcher.py_func.__code__.co_filename).resolve()
    name = f"{place.filename_base}-{source_hash(path)}"
    kept._cache_file = IndexDataCacheFile(kept.cache_path, name, name)


@cache
def source_hash(path: Path) -> str:
    """Return a hash of a file, of all files of cosim that it imports, to any depth, and of the compiler."""
    compiler = f"{numba.__version__} for {llvm.get_host_cpu_name()}"
    digest, found, to_do = sha256(compiler.encode()), {path}, [path]
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
    """Return the files of cosim that a file imports."""
    found = set()
    for module, names in _IMPORT.findall(_text(path)):
        folder = _PACKAGE.joinpath(*module.split(".")) if module else _PACKAGE
        for name in ("", *re.findall(r"\w+", names)):
            candidate = (folder / name if name else folder).with_suffix(".py")
            if candidate.is_file():
                found.add(candidate)
    return frozenset(found)


@final
class _NoCode:
    """What asks for a place in machine code where there is none."""

    def set_env(self, name: str, environment: Any) -> None:
        """Set nothing: kernels in nopython mode never look there."""


@final
class IntermediateCode(CPUCodeLibrary):
    """The code of one function, which is optimised together with a kernel that calls it."""

    def _optimize_final_module(self) -> None:
        """Leave it as it is."""

    def _finalize_final_module(self) -> None:
        """Make no machine code of it."""
        self._finalize_dynamic_globals()
        self._finalized = True

    @property
    def codegen(self) -> _NoCode:
        """What keeps track of the machine code."""
        return _NoCode()

    def get_pointer_to_function(self, name: str) -> int:
        """Return none, as there is no machine code."""
        return 0


@final
class DeviceCompiler(Compiler):
    """Compiles a function to `IntermediateCode`."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.state.library = IntermediateCode(self.state.targetctx.codegen(), "device_function")


@final
class DeviceFunction(CPUDispatcher):
    """A function that kernels call; called from Python it would have nothing to run."""

    hands_on_views = False

    def __call__(self, *_arguments: Any) -> NoReturn:
        """Refuse.

        Raises:
            TypeError: always.
        """
        raise TypeError(f"only kernels can call {self.py_func.__name__}(), which has no code of its own")

    def get_call_template(self, *given: Any) -> Any:
        """Return how the function that is being compiled calls this one.

        Raises:
            TypeError: it would give back references that this one has not counted.
        """
        if self.hands_on_views and ConfigStack().top().nrt:
            raise TypeError(
                f"{self.py_func.__name__}() counts no references to the views that it hands on: "
                "what is marked as allocating cannot call it"
            )
        return super().get_call_template(*given)

    def compile(self, signature: Any) -> Any:
        """Compile for a signature.

        Raises:
            TypeError: it hands on arrays among others, without a reference of their own; numba itself
                refuses an array alone.
        """
        found: Any = super().compile(signature)
        returned = [entry.return_type for entry in self.nopython_signatures]
        if not self.targetoptions["_nrt"] and not self.hands_on_views and any(map(_has_arrays, returned)):
            name = self.py_func.__name__
            raise TypeError(f"{name}() returns arrays: mark it as allocating or handing on views")
        return found


@final
class Kernel(CPUDispatcher):
    """A function that Python calls, and other kernels by its address; its machine code is kept alone."""

    def get_call_template(self, *_given: Any) -> NoReturn:
        """Refuse a call by its name: there is no intermediate code to take in.

        Raises:
            TypeError: always.
        """
        raise TypeError(
            f"{self.py_func.__name__}() is a kernel of its own: mark it as taken in, or call it by its "
            "address, see `kernel_calls`"
        )


def _is_known() -> bool:
    return str(numba.__version__).startswith(_KNOWN)


def _has_arrays(returned: Any) -> bool:
    parts = getattr(returned, "types", ())  # of a tuple
    return isinstance(returned, numba.types.Array) or any(map(_has_arrays, parts))


def device_dispatcher(function: Any, options: dict[str, Any]) -> Any:
    """Return what compiles a function for every kernel that calls it.

    With a numba whose insides are not known, it is an ordinary function of numba: it does the same, and
    takes longer to compile.

    Args:
        function: to be compiled.
        options: of `numba.njit`.
    """
    if not _is_known():
        return numba.njit(function, **options)
    alone = {"cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compile_later: Any = numba.njit
    found = compile_later(function, **options, **alone, pipeline_class=DeviceCompiler)
    found.__class__ = DeviceFunction  # numba makes dispatchers of one class alone
    return found


Function = TypeVar("Function", bound=Callable[..., Any])

# fastmath as a whole stays off: NaN must stay visible, and results must not depend on the compiler's mood.
# error_model="numpy" lets a division by zero give inf (a named outcome later) and keeps loops vectorised.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}

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


def kernel(
    signature: Any, *, reorder_sums: bool = False, allocates: bool = False, taken_in: bool = False
) -> Callable[[Function], Function]:
    """Return a decorator that turns a function into a kernel with one fixed signature.

    Args:
        signature: numba signature, kept as `fixed_signature` for `compile_kernels`.
        reorder_sums: whether sums may be taken in any order, with products fused into them, as BLAS does;
            values that are not finite stay visible.
        allocates: whether it makes arrays whose size it does not know when it is compiled, returns arrays, or
            calls what does; see `device_function` for what that costs, and `small_arrays` for the others.
        taken_in: whether other kernels call it by its name, each of which compiles it as a part of its own.

    Raises:
        TypeError: it returns arrays, and does not say that it allocates.
    """
    if not allocates and _has_arrays(getattr(signature, "return_type", None)):
        raise TypeError(f"a kernel of {signature} returns arrays: it has to say that it allocates")

    def decorate(function: Function) -> Function:
        fast: dict[str, Any] = {"fastmath": {"reassoc", "contract"}} if reorder_sums else {}
        dispatcher = _compiled_later(function, taken_in, _nrt=allocates, no_cfunc_wrapper=True, **fast)
        dispatcher.fixed_signature = signature
        result: Function = dispatcher
        return result

    return decorate


def device_function(function: Function) -> Function:
    """Mark a small function that kernels call; it is compiled with each of them, and for nothing else.

    It makes no arrays, and counts no references to those that it is given: every view of one costs two
    atomic additions otherwise, more than many a loop does.
    """
    result: Function = device_dispatcher(function, {**_OPTIONS, "_nrt": False})
    return result


def inlined(function: Function) -> Function:
    """Mark a device function that becomes part of its callers before anything is optimised.

    For what a loop over lanes calls: with calls in it that are inlined late, the loop is not vectorised.
    """
    result: Function = device_dispatcher(function, {**_OPTIONS, "_nrt": False, "forceinline": True})
    return result


def allocating(function: Function) -> Function:
    """Mark a device function that makes arrays, hands arrays of its own on, or calls what does."""
    result: Function = device_dispatcher(function, {**_OPTIONS, "_nrt": True})
    return result


def _compiled_later(function: Any, taken_in: bool, **options: Any) -> Any:
    """Return what compiles a function when it is called, and keeps the machine code where it can be."""
    try:
        dispatcher = numba.njit(function, **_OPTIONS, **options, cache=True)
    except RuntimeError:  # no place for a cache: neither beside the source nor in the user's directory
        return numba.njit(function, **_OPTIONS, **options)
    alone = _is_known() and not taken_in
    if alone:
        dispatcher.__class__ = Kernel
    keep_by_source(dispatcher, alone=alone)
    return dispatcher
