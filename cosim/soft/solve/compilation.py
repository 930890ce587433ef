"""Compiles every kernel of the soft model once, and says so when it takes long."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from cosim.base.kept.kernel_cache import remove_old
from cosim.soft.body import center_line
from cosim.soft.contact import obstacle_contact as contact
from cosim.soft.contact import point_kernels as contact_surface
from cosim.soft.elements import mass_terms, pressure
from cosim.soft.elements.element import kinds_known
from cosim.soft.linear import envelope_kernels, pattern, secant_pairs
from cosim.soft.linear import multifrontal_kernels as front_kernels
from cosim.soft.solve import held_nodes, problem, step_begin

_MODULES: tuple[ModuleType, ...] = (
    center_line, contact, contact_surface, envelope_kernels, front_kernels, held_nodes, mass_terms,
    pattern, pressure, problem, secant_pairs, step_begin,
)  # fmt: skip

_SECONDS_EACH = 0.6  # in the mean
_OBJECTS_BETWEEN = 100_000  # two collections of garbage


def common_modules() -> tuple[ModuleType, ...]:
    """Return the modules with kernels of every run: those of all known elements, and of what sums them."""
    return (*_MODULES, *dict.fromkeys(sys.modules[kind.__module__] for kind in kinds_known()))


def compile_kernels(
    announce: Callable[[str], None] = lambda _text: None, more: tuple[ModuleType, ...] = ()
) -> None:
    """Compile the kernels of every run, or load them from numba's cache on disk.

    Args:
        announce: told in one sentence, before the wait, when they have to be compiled.
        more: modules with further kernels.
    """
    compile_modules(announce, (*common_modules(), *more))


def compile_modules(announce: Callable[[str], None], modules: tuple[ModuleType, ...]) -> None:
    """Compile the kernels of modules, or load them; see `compile_kernels`."""
    found: dict[int, Any] = {
        id(value): value
        for module in modules
        for value in vars(module).values()
        if getattr(value, "fixed_signature", None) is not None
    }
    kernels = [kernel for kernel in found.values() if not kernel.overloads]
    told = False
    with _seldom_collecting():
        for kernel in kernels:
            before = sum(kernel.stats.cache_misses.values())
            kernel.compile(kernel.fixed_signature)
            if not told and sum(kernel.stats.cache_misses.values()) > before:
                tens_of_s = max(1, round(0.1 * _SECONDS_EACH * len(kernels)))
                announce(
                    f"Compiling {len(kernels)} kernels: the first run on a machine takes some "
                    f"{10 * tens_of_s} s longer, on a busy one twice that; the result is kept for later runs."
                )
                told = True
    if told:
        remove_old(kernels)


@contextmanager
def _seldom_collecting() -> Iterator[None]:
    """Look for garbage seldom: numba makes so many small objects that it would take a seventh of the time."""
    usual = gc.get_threshold()
    gc.set_threshold(_OBJECTS_BETWEEN, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)
