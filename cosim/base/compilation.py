"""Compiles kernels, or loads them from the cache on disk, and announces that to the user. Several processes
compile many kernels in parallel: each reads the next number from a pipe, until that is empty, and compiles
the kernels of the module with that number, since they have most functions in common. This process compiles
what the others have not written to the cache.
"""

import gc
import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from types import ModuleType
from typing import Any, Final

import numba

from cosim.base import compile_time
from cosim.base.numba_insides import KNOWN

_SLOW: Final = "" if KNOWN else f" numba {numba.__version__} is not 0.68: half as long again."
ANNOUNCEMENT: Final = (
    "Compiling kernels as they are first called, once per machine: about a minute of processor time in a "
    f"first run.{_SLOW}"
)
_QUIET_S: Final = 20.0  # a compilation so soon after another one is not announced again
_MOST_PROCESSES: Final = 4  # the slowest kernel bounds what more of them save
_EACH: Final = 2  # kernels that are worth the start of another process
_NUMBERS: Final = 256  # of one byte in the pipe: reads of one byte are never torn
_PATIENCE_S: Final = 300.0  # for the last kernels of another process
_OBJECTS_BETWEEN: Final = 100_000  # two collections of garbage


class _Compiling:
    """Whether this process is compiling a kernel, and when it last did [s]."""

    now = False
    last_s = -_QUIET_S


def compile_modules(modules: Iterable[ModuleType]) -> None:
    """Compile the kernels that modules define, without those that they import, unless they are on disk."""
    compile_kernels([kernel for module in modules for kernel in _kernels_of(module)])


def compile_kernels(kernels: Iterable[Any]) -> None:
    """Compile kernels before their first calls, in parallel, unless they are on disk.

    Args:
        kernels: kernels; plain Python functions among them are ignored.
    """
    distinct = [kernel for kernel in dict.fromkeys(kernels) if hasattr(kernel, "fixed_signature")]
    missing = [kernel for kernel in distinct if not is_ready(kernel)]
    if missing:
        with _announced():
            _compile_in_parallel(missing)
            for kernel in missing:
                kernel.compile(kernel.fixed_signature)


def is_ready(kernel: Any) -> bool:
    """Return whether a kernel is compiled, in this process or on disk."""
    return bool(kernel.overloads) or _is_on_disk(kernel)


def compile_called(kernel: Any, compile_as: Callable[[Any], Any], asked: Any) -> Any:
    """Compile a kernel, or load it; a compilation is announced if a call of the kernel causes it.

    Args:
        kernel: dispatcher.
        compile_as: numba's function that compiles for a signature, or for types of arguments.
        asked: a signature; or a tuple of types of arguments, if a call causes the compilation.
    """
    # without the type of the result, numba would store a second copy for the same arguments
    wanted = kernel.fixed_signature if asked == kernel.fixed_signature.args else asked
    if _Compiling.now or not isinstance(asked, tuple) or (wanted is not asked and _is_on_disk(kernel)):
        return compile_as(wanted)
    with _announced():
        return compile_as(wanted)


@contextmanager
def _announced() -> Iterator[None]:
    """Announce a compilation, unless one was just announced, and collect garbage seldom within it."""
    if time.monotonic() - _Compiling.last_s > _QUIET_S:
        logging.getLogger("cosim").warning(ANNOUNCEMENT)
    _Compiling.now = True
    try:
        with _rare_collections(), compile_time.counted():
            yield
    finally:
        _Compiling.now, _Compiling.last_s = False, time.monotonic()


def _is_on_disk(kernel: Any) -> bool:
    return kernel.cache is not None and kernel.cache.is_there(kernel.fixed_signature)


def _kernels_of(module: ModuleType) -> list[Any]:
    """Return the kernels that a module defines."""
    kernels = (
        value for value in vars(module).values() if getattr(value, "fixed_signature", None) is not None
    )
    return [value for value in kernels if value.__module__ == module.__name__]


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Collect garbage seldom: with numba's many small objects it would take a seventh of the time."""
    usual = gc.get_threshold()
    gc.set_threshold(_OBJECTS_BETWEEN, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def _compile_in_parallel(kernels: list[Any]) -> None:
    """Compile kernels in this process and in others; does nothing if only one processor is available.

    Args:
        kernels: dispatchers that are not on disk.
    """
    findable = [kernel for kernel in kernels if _is_findable(kernel)]
    count = min(processes(), (len(findable) + 1) // _EACH)
    if count < 2 or getattr(sys, "frozen", False):  # a frozen program cannot start another Python
        return
    parts = _parts(findable)
    read_end, write_end = os.pipe()
    try:
        with os.fdopen(write_end, "wb") as numbers:
            numbers.write(bytes(range(len(parts))))
        with _others(count - 1, parts, read_end) as others:
            compile_parts(read_end, parts)
            for other in others:
                with suppress(subprocess.TimeoutExpired):
                    other.wait(_PATIENCE_S)
    finally:
        os.close(read_end)


def processors() -> int:
    """Return how many processors this process may use; on macOS, how many the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processes() -> int:
    """Return how many processes may compile in parallel, at most `NUMBA_NUM_THREADS`."""
    usable = processors()
    return min(_MOST_PROCESSES, usable, int(os.environ.get("NUMBA_NUM_THREADS", usable)))


def compile_parts(read_end: int, parts: list[str]) -> None:
    """Compile the parts whose numbers are in a pipe, until the pipe is empty.

    Args:
        read_end: of the pipe.
        parts: "module:kernel,kernel" each.
    """
    while number := os.read(read_end, 1):
        module, names = parts[number[0]].split(":")
        for name in names.split(","):
            kernel = getattr(import_module(module), name)
            kernel.compile(kernel.fixed_signature)


@contextmanager
def _others(count: int, parts: list[str], read_end: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Start up to so many other processes, which run this file, and end them after the block."""
    started: list[subprocess.Popen[bytes]] = []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        with suppress(OSError):
            for _ in range(count):
                started.append(
                    subprocess.Popen(
                        [sys.executable or "", "-P", "-m", __name__, *parts],
                        env=environment, stdin=read_end, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    )
                )  # fmt: skip
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


def _is_findable(kernel: Any) -> bool:
    """Return whether another process can import a kernel by name, and write it to the cache of this one."""
    module = sys.modules.get(kernel.__module__)
    named = getattr(module, kernel.__name__, None) is kernel and kernel.__module__.startswith("cosim.")
    return named and kernel.cache is not None and kernel.cache.keeps


def _parts(kernels: list[Any]) -> list[str]:
    """Return one part of the work for each module, with the longest first."""
    modules: dict[str, list[Any]] = {}
    for kernel in kernels:
        modules.setdefault(kernel.__module__, []).append(kernel)
    longest = sorted(modules, key=lambda module: _size_of_code(modules[module]), reverse=True)[:_NUMBERS]
    return [f"{module}:{','.join(kernel.__name__ for kernel in modules[module])}" for module in longest]


def _size_of_code(kernels: list[Any]) -> int:
    """Return the size of the bytecode of kernels and of all device functions that they call."""
    visited, to_do, size = set(map(id, kernels)), [*kernels], 0
    while to_do:
        function = to_do.pop().py_func
        size += len(function.__code__.co_code)
        names, scope = function.__code__.co_names, function.__globals__
        modules = [vars(scope[name]) for name in names if isinstance(scope.get(name), ModuleType)]
        for called in (space[name] for space in (scope, *modules) for name in names if name in space):
            if hasattr(called, "py_func") and id(called) not in visited:
                visited.add(id(called))
                to_do.append(called)
    return size


if __name__ == "__main__":
    with _rare_collections():
        compile_parts(sys.stdin.fileno(), sys.argv[1:])
