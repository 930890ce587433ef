"""Kernels are compiled once, here, before any worker needs them: many processes at once would each do it."""

from __future__ import annotations

import logging
import sys
from functools import cache

from cosim.build.kernel_modules import kernel_modules
from cosim.config.schema.scenario import Scenario


def warm_up(scenario: Scenario) -> None:
    """Compile the kernels of a scenario, unless those of another one like it have been.

    Args:
        scenario: checked.
    """
    _compile(tuple(module.__name__ for module in kernel_modules(scenario)))


@cache
def _compile(names: tuple[str, ...]) -> None:
    import cosim.build.simulation  # noqa: F401  # the engines: a run waits for them, too
    from cosim.soft.solve.compilation import compile_kernels  # here: it loads the kernels

    announce = logging.getLogger("cosim").warning
    compile_kernels(announce, tuple(sys.modules[name] for name in names))
