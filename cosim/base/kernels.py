"""How the numba kernels are compiled: for one fixed signature each, cached on disk, without fast-math.

Importing a kernel compiles nothing; `compile_kernels` in compilation.py does, once, and says so.

A device function is compiled to intermediate code alone: numba would optimise it by itself, make machine code
of it and a way to call it from Python, and keep that on disk; the compilation of each kernel that calls it
then does the same again.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NoReturn, TypeVar, final

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORT = re.compile(r"^\s*(?:from|import) cosim\.?([\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)
_OLD_S = 7 * 24 * 3600.0
_KNOWN = "0.68."  # numba whose insides are as `IntermediateCode` and `DeviceCompiler` take them


def keep_by_source(dispatcher: Any) -> None:
    """Let a cached kernel be kept, where numba keeps it, under the hash of its source.

    Args:
        dispatcher: of a function of cosim, declared with `cache=True`.
    """
    kept = dispatcher._cache  # numba has no public way to say what else a kernel depends on
    place = kept._impl
    path = Path(dispatcher.py_func.__code__.co_filename).resolve()
    name = f"{place.filename_base}-{source_hash(path)}"
    kept._cache_file = IndexDataCacheFile(kept.cache_path, name, place.locator.get_source_stamp())


@cache
def source_hash(path: Path) -> str:
    """Return a hash of a file and of all files of cosim that it imports, to any depth."""
    digest, found, to_do = sha256(), {path}, [path]
    while to_do:
        for imported in _imports(to_do.pop()) - found:
            found.add(imported)
            to_do.append(imported)
    for entry in sorted(found):
        digest.update(_text(entry).encode())
    return digest.hexdigest()[:12]


def remove_old(kernels: Iterable[Any]) -> None:
    """Delete machine code of other versions of kernels, if it was made more than a week ago.

    Args:
        kernels: dispatchers of `keep_by_source`.
    """
    for kernel in kernels:
        kept = kernel._cache
        folder, base = Path(kept.cache_path), kept._impl.filename_base
        own = f"{base}-{source_hash(Path(kernel.py_func.__code__.co_filename).resolve())}."
        with suppress(OSError):  # another process may do the same
            for path in folder.glob(f"{base}[-.]*.nb[ic]"):
                if not path.name.startswith(own) and time.time() - path.stat().st_mtime > _OLD_S:
                    path.unlink()


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

    def __call__(self, *_arguments: Any) -> NoReturn:
        """Refuse.

        Raises:
            TypeError: always.
        """
        raise TypeError(f"only kernels can call {self.py_func.__name__}(), which has no code of its own")

    def compile(self, signature: Any) -> Any:
        """Compile for a signature.

        Raises:
            TypeError: it hands on arrays among others, without a reference of their own; numba itself
                refuses an array alone.
        """
        found: Any = super().compile(signature)
        returned = [entry.return_type for entry in self.nopython_signatures]
        if not self.targetoptions["_nrt"] and any(map(_has_arrays, returned)):
            raise TypeError(f"{self.py_func.__name__}() returns arrays: mark it as allocating")
        return found


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
    if not numba.__version__.startswith(_KNOWN):
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
    signature: Any, *, reorder_sums: bool = False, allocates: bool = False
) -> Callable[[Function], Function]:
    """Return a decorator that turns a function into a kernel with one fixed signature.

    Args:
        signature: numba signature, kept as `fixed_signature` for `compile_kernels`.
        reorder_sums: whether sums may be taken in any order, with products fused into them, as BLAS does;
            values that are not finite stay visible.
        allocates: whether it makes arrays whose size it does not know when it is compiled, returns arrays, or
            calls what does; see `device_function` for what that costs, and `small_arrays` for the others.

    Raises:
        TypeError: it returns arrays, and does not say that it allocates.
    """
    if not allocates and _has_arrays(getattr(signature, "return_type", None)):
        raise TypeError(f"a kernel of {signature} returns arrays: it has to say that it allocates")

    def decorate(function: Function) -> Function:
        fast: dict[str, Any] = {"fastmath": {"reassoc", "contract"}} if reorder_sums else {}
        dispatcher = _compiled_later(function, _nrt=allocates, no_cfunc_wrapper=True, **fast)
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
    """Mark a device function that makes arrays, hands arrays on, or calls what does."""
    result: Function = device_dispatcher(function, {**_OPTIONS, "_nrt": True})
    return result


def _compiled_later(function: Any, **options: Any) -> Any:
    """Return what compiles a function when it is called, and keeps the machine code where it can be."""
    try:
        dispatcher = numba.njit(function, **_OPTIONS, **options, cache=True)
    except RuntimeError:  # no place for a cache: neither beside the source nor in the user's directory
        return numba.njit(function, **_OPTIONS, **options)
    keep_by_source(dispatcher)
    return dispatcher


def nothing_of(kind: Any) -> Any:
    """Return arrays without entries, and zeros, that stand for nothing where a kernel takes some type."""
    if isinstance(kind, numba.types.NamedTuple):
        return kind.instance_class(*map(nothing_of, kind.types))
    if isinstance(kind, numba.types.Array):
        return np.zeros((0,) * kind.ndim, str(kind.dtype))
    return False if kind == BOOLEAN else kind.cast_python_value(0)


@device_function
def add_block(blocks: Any, slot: int, value: Any) -> None:
    """Add a 3 x 3 value to block `slot`, or its transpose to block -1 - slot."""
    if slot >= 0:
        for r in range(3):
            for c in range(3):
                blocks[slot, r, c] += value[r, c]
    else:
        slot = -1 - slot
        for r in range(3):
            for c in range(3):
                blocks[slot, r, c] += value[c, r]
