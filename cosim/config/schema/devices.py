"""Schema of the devices of a scenario: pumps, winches, controllers. They act in time: dynamic mode only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, final

from annotated_types import Len

from cosim.config.toml.constraints import Name, NonNegative, Positive


@final
@dataclass(frozen=True)
class PumpTable:
    """A pump with a pressure switch on the gas of a chamber, at work where a phase gives `pump_pressure_Pa`.

    Args:
        name: of the pump; phases set its pressure by it.
        chamber: whose gas; omitted: that of the only chamber.
        flow_kg_s: mass flow without counter-pressure.
        pressure_max_Pa: gauge pressure against which nothing is delivered; omitted: the flow is constant.
        band_Pa: on half of it below the setpoint, off half of it above.
        sensor_delay_s: age of the pressure that the switch sees; rounded to whole ticks.
        vent_above_Pa: above the setpoint, where a valve opens until the setpoint is reached; omitted: none.
        vent_kg_s_Pa: mass flow of the open valve per pascal of gauge pressure.
    """

    name: Name
    flow_kg_s: Positive
    chamber: str | None = None
    pressure_max_Pa: Positive | None = None
    band_Pa: NonNegative = 1e3
    sensor_delay_s: NonNegative = 0.0
    vent_above_Pa: Positive | None = None
    vent_kg_s_Pa: NonNegative = 0.0


@final
@dataclass(frozen=True)
class WinchTable:
    """Winches of one kind, one per cable, which go to the cable lengths that phases and controllers command.

    Args:
        name: of the winch.
        cables: names.
        step_angle_rad: of the motor, per commanded (micro)step.
        gear_ratio: turns of the motor per turn of the drum.
        drum_radius_m: to the middle of the cable.
        step_rate_per_s: highest rate of steps.
        stall_torque_Nm: of the motor, above which steps are lost.
    """

    name: Name
    cables: Annotated[tuple[str, ...], Len(min_length=1)]
    step_angle_rad: Positive
    drum_radius_m: Positive
    step_rate_per_s: Positive
    stall_torque_Nm: Positive
    gear_ratio: Positive = 1.0


@final
@dataclass(frozen=True)
class ControllerTable:
    """A controller with a fixed rate, which acts in the phases that name it.

    Args:
        name: of the controller; phases give its setpoint by it.
        kind: "bang_bang": raises or lowers its output by `increment` per period; "pi": proportional and
            integral; "python": handed to `cosim.run(..., controllers={name: controller})`.
        period_s: between two samples, a whole number of ticks; the command holds in between.
        measures: what it keeps at its setpoint.
        commands: its output.
        cables: that it moves, all alike.
        increment: bang_bang: change of the output per period, in the output's unit.
        band: bang_bang: width about the setpoint in which the output stays, in the measured unit.
        proportional_gain: pi: output per error.
        integral_gain_per_s: pi: output per error and second.
        output_min: lowest output.
        output_max: highest output; omitted: none.
    """

    name: Name
    kind: Literal["bang_bang", "pi", "python"]
    period_s: Positive
    measures: Literal["bending_angle_rad", "tip_height_m"] = "bending_angle_rad"
    commands: Literal["cable_tension_N", "cable_shortening_m"] = "cable_tension_N"
    cables: tuple[str, ...] = ()
    increment: Positive | None = None
    band: NonNegative = 0.0
    proportional_gain: NonNegative | None = None
    integral_gain_per_s: NonNegative | None = None
    output_min: float = 0.0
    output_max: float | None = None
