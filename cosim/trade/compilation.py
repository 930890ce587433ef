"""Compiles what any candidate of a trade needs, so that no candidate's time holds a compilation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

from cosim.build.kernel_modules import contact_modules, kernel_modules
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.soft.solve.compilation import compile_kernels


def compile_for_trade(
    scenario: Scenario, tell: Callable[[str], None], more: tuple[ModuleType, ...] = ()
) -> None:
    """Compile the kernels of a scenario's lower fidelities and switches as well as its own.

    Args:
        scenario: checked.
        tell: told in one sentence, before the wait, when there is anything to compile.
        more: modules with kernels of what follows the runs.
    """
    everything = replace(scenario, fidelity="section", contact=replace(scenario.contact, self_contact=True))
    contact = () if scenario.robot == NO_ARM else contact_modules()
    compile_kernels(tell, (*more, *kernel_modules(everything), *contact))
