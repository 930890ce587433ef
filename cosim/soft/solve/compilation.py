"""Compiles every kernel of the soft model once, and says so when it takes long."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType

from cosim.base.compilation import compile_modules
from cosim.soft.body import places
from cosim.soft.contact import obstacle_contact as contact
from cosim.soft.contact import point_kernels as contact_surface
from cosim.soft.elements import mass_terms, pressure
from cosim.soft.elements.element import kinds_known
from cosim.soft.film import film_terms
from cosim.soft.linear import envelope_kernels, pattern, secant_pairs
from cosim.soft.solve import film_step, state, step_begin

_MODULES: tuple[ModuleType, ...] = (
    places, contact, contact_surface, envelope_kernels, film_step, film_terms, state, mass_terms,
    pattern, pressure, secant_pairs, step_begin,
)  # fmt: skip


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
