"""How kernels are compiled when they are first called, or loaded: announced, and side by side where many are.

Each process that compiles, this one as well, takes the next number from one pipe until that is empty, and
compiles the kernels of one module, which have most functions in common. Whatever a process has not left on
disk is compiled by the one that asked.
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

from cosim.base.numba_insides import KNOWN

_SLOW: Final = "" if KNOWN else f" numba {numba.__version__} is not 0.68: half as long again."
ANNOUNCEMENT: Final = (
    "Compiling kernels as they are first called, once per machine: about a minute of processor time in a "
    f"first run.{_SLOW}"
)
_QUIET_S: Final = 20.0  # for so long after a compilation, the next one belongs to what was announced
_MOST_PROCESSES: Final = 4  # the slowest kernel bounds what more of them save
_EACH: Final = 2  # kernels, for which another process is worth its start
_NUMBERS: Final = 256  # of one byte in the pipe: reads of one byte are never torn
_PATIENCE_S: Final = 300.0  # with a process that has taken its last number
_OBJECTS_BETWEEN: Final = 100_000  # two collections of garbage


class _Compiling:
    """Whether this process compiles a kernel by now, and when it last did so [s]."""

    now = False
    last_s = -_QUIET_S


def compile_modules(modules: Iterable[ModuleType]) -> None:
    """Compile the kernels of modules, not those that they import, unless they are on disk."""
    compile_kernels([kernel for module in modules for kernel in _kernels_of(module)])


def compile_kernels(kernels: Iterable[Any]) -> None:
    """Compile kernels ahead of their first calls, side by side, unless they are on disk.

    Args:
        kernels: of other functions, in plain Python, among them nothing is done.
    """
    found = [kernel for kernel in dict.fromkeys(kernels) if hasattr(kernel, "fixed_signature")]
    missing = [kernel for kernel in found if not (kernel.overloads or _is_kept(kernel))]
    if missing:
        with _announced():
            _compile_side_by_side(missing)
            for kernel in missing:
                kernel.compile(kernel.fixed_signature)


def compile_called(kernel: Any, compile_as: Callable[[Any], Any], asked: Any) -> Any:
    """Compile a kernel, or load it; announced if a call asks for that.

    Args:
        kernel: dispatcher.
        compile_as: numba's way for a signature, or the types of arguments.
        asked: a signature; or types of arguments, by a call.
    """
    # for its own types of arguments without that of what it returns, numba would keep it twice
    wanted = kernel.fixed_signature if asked == kernel.fixed_signature.args else asked
    if _Compiling.now or not isinstance(asked, tuple) or (wanted is not asked and _is_kept(kernel)):
        return compile_as(wanted)
    with _announced():
        return compile_as(wanted)


@contextmanager
def _announced() -> Iterator[None]:
    """Say that kernels are compiled, unless that was just said, and do so with few searches for garbage."""
    if time.monotonic() - _Compiling.last_s > _QUIET_S:
        logging.getLogger("cosim").warning(ANNOUNCEMENT)
    _Compiling.now = True
    try:
        with _seldom_collecting():
            yield
    finally:
        _Compiling.now, _Compiling.last_s = False, time.monotonic()


def _is_kept(kernel: Any) -> bool:
    return kernel.cache is not None and kernel.cache.is_there(kernel.fixed_signature)


def _kernels_of(module: ModuleType) -> list[Any]:
    """Return the kernels that a module defines."""
    own = (value for value in vars(module).values() if getattr(value, "fixed_signature", None) is not None)
    return [value for value in own if value.__module__ == module.__name__]


@contextmanager
def _seldom_collecting() -> Iterator[None]:
    """Look for garbage seldom: numba makes so many small objects that it would take a seventh of the time."""
    usual = gc.get_threshold()
    gc.set_threshold(_OBJECTS_BETWEEN, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def _compile_side_by_side(kernels: list[Any]) -> None:
    """Compile kernels in their own processes and in this one, where there are processors for it.

    Args:
        kernels: dispatchers that are not on disk.
    """
    shared = [kernel for kernel in kernels if _is_shared(kernel)]
    count = min(processes(), (len(shared) + 1) // _EACH)
    if count < 2 or getattr(sys, "frozen", False):  # where it is no Python that runs
        return
    parts = _parts(shared)
    take, give = os.pipe()
    try:
        with os.fdopen(give, "wb") as numbers:
            numbers.write(bytes(range(len(parts))))
        with _others(count - 1, parts, take) as others:
            compile_parts(take, parts)
            for other in others:
                with suppress(subprocess.TimeoutExpired):
                    other.wait(_PATIENCE_S)
    finally:
        os.close(take)


def processors() -> int:
    """Return how many processors this process may use; macOS only knows how many the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processes() -> int:
    """Return how many may compile at once: at most as many as `NUMBA_NUM_THREADS` says."""
    usable = processors()
    return min(_MOST_PROCESSES, usable, int(os.environ.get("NUMBA_NUM_THREADS", usable)))


def compile_parts(take: int, parts: list[str]) -> None:
    """Compile those parts whose numbers are in a pipe, until it is empty.

    Args:
        take: end of the pipe.
        parts: "module:kernel,kernel" each.
    """
    while number := os.read(take, 1):
        module, names = parts[number[0]].split(":")
        for name in names.split(","):
            kernel = getattr(import_module(module), name)
            kernel.compile(kernel.fixed_signature)


@contextmanager
def _others(count: int, parts: list[str], take: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Start further processes, as far as they can be, and end them: they run this file, not the user's."""
    found: list[subprocess.Popen[bytes]] = []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        with suppress(OSError):
            for _ in range(count):
                found.append(
                    subprocess.Popen(
                        [sys.executable or "", "-P", "-m", __name__, *parts],
                        env=environment, stdin=take, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    )
                )  # fmt: skip
        yield found
    finally:
        for process in found:
            process.kill()
            process.wait()


def _is_shared(kernel: Any) -> bool:
    """Return whether another process finds a kernel by its name, and leaves it where this one looks."""
    module = sys.modules.get(kernel.__module__)
    named = getattr(module, kernel.__name__, None) is kernel and kernel.__module__.startswith("cosim.")
    return named and kernel.cache is not None and kernel.cache.keeps


def _parts(kernels: list[Any]) -> list[str]:
    """Return parts of the work, those with most code first, which take longest."""
    modules: dict[str, list[Any]] = {}
    for kernel in kernels:
        modules.setdefault(kernel.__module__, []).append(kernel)
    longest = sorted(modules, key=lambda module: _size_of_code(modules[module]), reverse=True)[:_NUMBERS]
    return [f"{module}:{','.join(kernel.__name__ for kernel in modules[module])}" for module in longest]


def _size_of_code(kernels: list[Any]) -> int:
    """Return the size of the bytecode of kernels and of all functions in them."""
    found, to_do, size = set(map(id, kernels)), [*kernels], 0
    while to_do:
        function = to_do.pop().py_func
        size += len(function.__code__.co_code)
        names, own = function.__code__.co_names, function.__globals__
        modules = [vars(own[name]) for name in names if isinstance(own.get(name), ModuleType)]
        for called in (place[name] for place in (own, *modules) for name in names if name in place):
            if hasattr(called, "py_func") and id(called) not in found:
                found.add(id(called))
                to_do.append(called)
    return size


if __name__ == "__main__":
    with _seldom_collecting():
        compile_parts(sys.stdin.fileno(), sys.argv[1:])
