"""What a run needs before its first tick: kernels, section models, the simulation itself."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cosim.base.kept_parts import KeptParts
from cosim.config.schema.scenario import Scenario
from cosim.config.several_arms import ArmsScenario, of_arm

if TYPE_CHECKING:
    from cosim.build.given_body import AnyBody, NamedBody
    from cosim.stepping.stepped_run import SteppedRun


def build_simulation(scenario: Scenario, *given: Any, **further: Any) -> SteppedRun:
    """Return the simulation of a checked scenario; loads the engines, which wrong input need not wait for.

    Args:
        scenario: checked.
        given: as `cosim.build.simulation.build` takes it.
        further: the same, by name.
    """
    from cosim.build import simulation

    return simulation.build(scenario, *given, **further)


def prepared(scenario: Scenario, tell: Callable[[str], None], *, kept: KeptParts | None = None) -> Scenario:
    """Return the scenario; the section model that it may ask for is built when this returns.

    Args:
        scenario: checked.
        tell: told in one sentence, beforehand, what takes long.
        kept: parts that may be used again; it gets those that are made here.
    """
    if scenario.fidelity == "section":
        from cosim.build.soft_model import SoftModel  # here, as few runs build one

        SoftModel(scenario, KeptParts() if kept is None else kept, tell=tell)
    return scenario


def prepared_arms(scenario: ArmsScenario, tell: Callable[[str], None], *, kept: KeptParts) -> ArmsScenario:
    """Return the scenario with each arm's model built."""
    arms = dict[str, Scenario]()
    for name, one in scenario.arms.items():
        with of_arm(name):
            arms[name] = prepared(one, tell, kept=kept)
    return replace(scenario, arms=arms)


def warm_up() -> None:
    """Compile all kernels that a run with an arm imports, whether it calls them or not."""
    from cosim.base.compilation import compile_modules  # here: it brings the compiler
    from cosim.build import arm_parts, simulation  # noqa: F401  # with all that they import
    from cosim.recording import film_colours  # noqa: F401
    from cosim.stepping import scene_carrier  # noqa: F401

    compile_modules(module for name, module in list(sys.modules.items()) if name.startswith("cosim."))


def named_body(body: AnyBody | None) -> NamedBody | None:
    """Return a copy of a body that is given in place of a scenario's soft robot, with names; None if none is.

    Raises:
        InputError: it cannot be simulated.
    """
    if body is None:
        return None
    from cosim.build.given_body import NamedBody  # here, as few runs need the film's engine so early

    return NamedBody.of(deepcopy(body))  # whoever gave it may write to its arrays


def log(text: str) -> None:
    """Tell whoever runs cosim from Python: by the logger "cosim", on the screen unless that is set up."""
    logging.getLogger("cosim").warning(text)
