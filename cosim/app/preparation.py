"""Prepares runs: compiled kernels, section models, the simulation itself."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING, Any

from cosim.base.kept_parts import KeptParts
from cosim.config.schema.scenario import Scenario

if TYPE_CHECKING:
    from cosim.build.given_body import AnyBody, NamedBody
    from cosim.stepping.stepped_run import SteppedRun


def build_simulation(scenario: Scenario, *given: Any, **further: Any) -> SteppedRun:
    """Return the simulation of a checked scenario; loads the engines, so wrong input is refused earlier.

    Args:
        scenario: checked.
        given: arguments of `cosim.build.simulation.build`.
        further: the same, by name.
    """
    from cosim.build import simulation

    return simulation.build(scenario, *given, **further)


def build_section_model(scenario: Scenario, tell: Callable[[str], None], kept: KeptParts) -> None:
    """Build the section model of a scenario, if it needs one, so that runs after it find it on disk.

    Args:
        scenario: checked.
        tell: called with a sentence before something takes long.
        kept: parts that may be used again; those that are made here are added.
    """
    if scenario.fidelity == "section":
        from cosim.build.soft_model import SoftModel  # here: few runs build one

        SoftModel(scenario, kept, tell=tell)


def warm_up() -> None:
    """Compile all kernels that a run with an arm imports, called or not."""
    from cosim.base.compilation import compile_modules  # here: it loads the compiler
    from cosim.build import arm_parts, section_models, simulation  # noqa: F401  # with all their imports
    from cosim.coupling.robots import beam_robot  # noqa: F401
    from cosim.recording import film_colours  # noqa: F401
    from cosim.stepping import arm_carrier  # noqa: F401

    compile_modules(module for name, module in list(sys.modules.items()) if name.startswith("cosim."))


def named_body(body: AnyBody | None) -> NamedBody | None:
    """Return a named copy of a body that replaces a scenario's soft robot; None for None.

    Raises:
        InputError: the body cannot be simulated.
    """
    if body is None:
        return None
    from cosim.build.given_body import NamedBody  # here: it loads the film's engine

    return NamedBody.of(deepcopy(body))  # the user may write to the arrays of the body


def log(text: str) -> None:
    """Log a text for users of Python, by the logger "cosim", which by default writes to the screen."""
    logging.getLogger("cosim").warning(text)
