"""What a first run on a machine waits for: kernels are compiled, section models built, choices measured."""

from __future__ import annotations

import logging
from collections.abc import Callable
from copy import deepcopy
from types import ModuleType
from typing import TYPE_CHECKING

from cosim.app.driver import build_simulation, recorded
from cosim.base.kept_parts import KeptParts
from cosim.base.whole_files import cache_directory
from cosim.build.kernel_modules import contact_modules, kernel_modules
from cosim.config.schema.scenario import NO_ARM, Scenario

if TYPE_CHECKING:
    from cosim.build.soft_body import AnyBody, NamedBody


def prepared(
    scenario: Scenario,
    tell: Callable[[str], None],
    *,
    recording: bool,
    contact: bool = False,
    kept: KeptParts | None = None,
) -> Scenario:
    """Return the scenario with its fidelity chosen; whatever its loop calls is compiled when this returns.

    Except for the kernels of contact with a scene, which `build_simulation` compiles: it knows the plan.

    Args:
        scenario: checked.
        tell: told in one sentence, beforehand, what takes long.
        recording: whether the run is recorded.
        contact: whether to compile those as well, if there is an arm.
        kept: parts that may serve again, and get those that are made here.

    Raises:
        ScenarioError: no fidelity meets its `[auto]`.
    """
    from cosim.soft.solve.compilation import compile_kernels  # here, so that wrong input needs no engine

    compile_kernels(tell, _modules(scenario, recording))
    chosen = with_fidelity_chosen(scenario, tell, kept)
    touched = contact_modules() if contact and scenario.robot != NO_ARM else ()
    compile_kernels(tell, (*_modules(chosen, recording), *touched))
    return chosen


def with_fidelity_chosen(
    scenario: Scenario, tell: Callable[[str], None], kept: KeptParts | None = None
) -> Scenario:
    """Return the scenario with `fidelity = "auto"` replaced by what meets its `[auto]`; build what it needs.

    Args:
        scenario: checked.
        tell: told what is measured, and what is chosen.
        kept: parts that may serve again, and get those that are made here.

    Raises:
        ScenarioError: nothing meets it.
    """
    if scenario.fidelity == "auto":
        from cosim.trade.auto import chosen_fidelity  # here: few runs measure anything

        scenario = chosen_fidelity(scenario, build_simulation, cache_directory(), tell, recorded)
    if scenario.fidelity == "section":
        from cosim.build.soft_model import SoftModel  # here, as few runs build one

        SoftModel(scenario, KeptParts() if kept is None else kept, tell=tell)
    return scenario


def named_body(body: AnyBody | None) -> NamedBody | None:
    """Return a copy of a body that is given in place of a scenario's soft robot, with names; None if none is.

    Raises:
        InputError: it cannot be simulated.
    """
    if body is None:
        return None
    from cosim.build.soft_body import NamedBody  # here, as few runs need the film's engine so early

    return NamedBody.of(deepcopy(body))  # whoever gave it may write to its arrays


def log(text: str) -> None:
    """Tell whoever runs cosim from Python: by the logger "cosim", on the screen unless that is set up."""
    logging.getLogger("cosim").warning(text)


def _modules(scenario: Scenario, recording: bool) -> tuple[ModuleType, ...]:
    """Return the modules with kernels that some runs do without."""
    modules = kernel_modules(scenario)
    if recording:
        from cosim.recording import colours

        modules = (colours, *modules)
    return modules
