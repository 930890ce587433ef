"""How kernels are compiled before they are needed, or loaded: announced, and side by side.

Each process that compiles, this one as well, takes the next number from one pipe until that is empty, and
compiles the kernels of one module, which have most functions in common. Whatever a process has not left on
disk is compiled by the one that asked.
"""

import gc
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from types import ModuleType
from typing import Any

from cosim.base.numba_insides import SLOW

_UNSAID = [SLOW]  # announced once
_SECONDS_EACH = 1.1  # of CPU time, on average
_SECONDS_EACH_BY_NAME = 4.5  # with another numba (measured: 0.60): kernels compile all that they call
_MOST_PROCESSES = 4  # the slowest kernel bounds what more of them save
_EACH = 3  # kernels, for which another process is worth its start
_NUMBERS = 256  # of one byte in the pipe: reads of one byte are never torn
_PATIENCE_S = 300.0  # with a process that has taken its last number
_OBJECTS_BETWEEN = 100_000  # two collections of garbage


def compile_modules(announce: Callable[[str], None], modules: tuple[Any, ...]) -> None:
    """Compile the kernels of modules, not those that they import, or load them.

    Args:
        announce: called with one sentence, before the wait, when they have to be compiled.
        modules: that hold them; and single kernels, where others of their modules are not needed.
    """
    found: dict[int, Any] = {id(kernel): kernel for entry in modules for kernel in _kernels_of(entry)}
    kernels = [kernel for kernel in found.values() if not kernel.overloads]
    missing = [k for k in kernels if k.cache is None or not k.cache.is_there(k.fixed_signature)]
    for sentence in filter(None, _UNSAID):
        announce(sentence)
    _UNSAID.clear()
    with _seldom_collecting():
        if missing:
            announce(_sentence(missing))
            _compile_side_by_side(missing)
        for kernel in kernels:
            kernel.compile(kernel.fixed_signature)


def _kernels_of(entry: Any) -> list[Any]:
    """Return the kernels that a module defines, or the one kernel that is given."""
    if not isinstance(entry, ModuleType):
        return [entry]
    own = (value for value in vars(entry).values() if getattr(value, "fixed_signature", None) is not None)
    return [value for value in own if value.__module__ == entry.__name__]


def _sentence(missing: list[Any]) -> str:
    kernels, apart = len(missing), any(kernel.by_address for kernel in missing)
    each_s = _SECONDS_EACH if apart else _SECONDS_EACH_BY_NAME
    tens_of_s = [max(1, round(0.1 * each_s * kernels / count)) for count in (1, processes())]
    return (
        f"Compiling {kernels} kernel{'s' if kernels > 1 else ''}, once per machine: about "
        f"{10 * tens_of_s[0]} s of processor time, {10 * tens_of_s[1]} s if nothing else runs."
    )


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
        kernels: dispatchers that are not on disk; this process loads none that another has compiled.
    """
    shared = [kernel for kernel in kernels if _is_shared(kernel)]
    count = min(processes(), len(shared) // _EACH)
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
