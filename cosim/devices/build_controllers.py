"""Builds the controllers of a scenario from their tables and from those passed in Python."""

from collections.abc import Mapping

import numpy as np

from cosim.config.schema.devices import ControllerTable
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import AnyController, Controller
from cosim.devices.feedback import BangBang, FeedbackLaw, FeedbackLoop, ProportionalIntegral, TipFollower
from cosim.devices.zero_order_hold import ZeroOrderHold
from cosim.errors import InputError, ScenarioError


def build_holds(scenario: Scenario, given: Mapping[str, AnyController]) -> dict[str, ZeroOrderHold]:
    """Return the controllers of a scenario, each in a `ZeroOrderHold`, by name.

    Args:
        scenario: checked.
        given: controllers of kind "python", by name.

    Raises:
        ScenarioError: one is missing.
        InputError: one is passed that the scenario does not name, or that is not a `Controller`.
    """
    expected = [entry.name for entry in scenario.controllers if entry.kind == "python"]
    for name, controller in given.items():
        if name not in expected:
            raise InputError(
                f"controllers: the scenario has no [[controller]] '{name}' of kind 'python'; it has: "
                f"{', '.join(expected) or 'none'}"
            )
        if not isinstance(controller, Controller):
            raise InputError(
                f"controllers: '{name}' is a {type(controller).__name__}; derive it from cosim.Controller"
            )
    cables, pumps = scenario.soft_robot.cable_names(), tuple(pump.name for pump in scenario.pumps)
    holds = {}
    for entry in scenario.controllers:
        period = round(entry.period_s / scenario.clock.tick_s)
        holds[entry.name] = ZeroOrderHold(entry.name, _controller(entry, given), period, cables, pumps)
    return holds


def _controller(entry: ControllerTable, given: Mapping[str, AnyController]) -> AnyController:
    if entry.kind == "python":
        if entry.name not in given:
            raise ScenarioError(
                f"controller.{entry.name}.kind",
                f"'python' needs the controller itself: cosim.run(..., controllers={{'{entry.name}': ...}})",
            )
        return given[entry.name]
    if entry.measures == "tip_position_m":
        gains = entry.proportional_gain or 0.0, entry.integral_gain_per_s or 0.0
        return TipFollower(*gains, entry.period_s)
    assert entry.commands != "flange_twist", "checked with the scenario"
    return FeedbackLoop(entry.measures, _law(entry), entry.commands, entry.cables)


def _law(entry: ControllerTable) -> FeedbackLaw:
    highest = np.inf if entry.output_max is None else entry.output_max
    if entry.kind == "bang_bang":
        assert entry.increment is not None, "checked with the scenario"
        return BangBang(entry.increment, entry.band, entry.output_min, highest)
    gains = entry.proportional_gain or 0.0, entry.integral_gain_per_s or 0.0
    return ProportionalIntegral(*gains, entry.period_s, entry.output_min, highest)
