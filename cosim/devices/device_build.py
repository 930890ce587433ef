"""Makes devices and controllers from their tables."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cosim.config.schema.devices import ControllerTable, PumpTable, WinchTable
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import AnyController, Controller
from cosim.devices.feedback_law import BangBang, FeedbackLaw, ProportionalIntegral
from cosim.devices.feedback_loop import FeedbackLoop
from cosim.devices.pump import Pump
from cosim.devices.winch import Winch
from cosim.devices.zero_order_hold import ZeroOrderHold
from cosim.errors import InputError, ScenarioError


def build_pump(entry: PumpTable, tick_s: float) -> Pump:
    """Return the pump of a table; its sensor's delay is rounded to whole ticks."""
    return Pump(
        flow_kg_s=entry.flow_kg_s,
        band_Pa=entry.band_Pa,
        pressure_max_Pa=math.inf if entry.pressure_max_Pa is None else entry.pressure_max_Pa,
        sensor_delay_ticks=round(entry.sensor_delay_s / tick_s),
        vent_above_Pa=math.inf if entry.vent_above_Pa is None else entry.vent_above_Pa,
        vent_kg_s_Pa=entry.vent_kg_s_Pa,
    )


def build_winch(entry: WinchTable) -> Winch:
    """Return the winch of a table."""
    return Winch(
        entry.step_angle_rad, entry.gear_ratio, entry.drum_radius_m, entry.step_rate_per_s,
        entry.stall_torque_Nm,
    )  # fmt: skip


def build_holds(scenario: Scenario, given: Mapping[str, AnyController]) -> dict[str, ZeroOrderHold]:
    """Return every controller at its rate, by name.

    Args:
        scenario: checked.
        given: controllers of kind "python", by name.

    Raises:
        ScenarioError: one is missing.
        InputError: one is given that the scenario does not name, or that is no controller.
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
    return FeedbackLoop(entry.measures, _law(entry), entry.commands, entry.cables)


def _law(entry: ControllerTable) -> FeedbackLaw:
    highest = math.inf if entry.output_max is None else entry.output_max
    if entry.kind == "bang_bang":
        assert entry.increment is not None, "checked with the scenario"
        return BangBang(entry.increment, entry.band, entry.output_min, highest)
    gains = entry.proportional_gain or 0.0, entry.integral_gain_per_s or 0.0
    return ProportionalIntegral(*gains, entry.period_s, entry.output_min, highest)
