"""Tables of the devices of a scenario: pumps, winches, controllers. They act in time, so they need mode =
"dynamic".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal, final

from annotated_types import Len

from cosim.config.toml.quantities import (
    Name,
    NonNegative,
    NonNegativeConductance,
    NonNegativePressure,
    NonNegativeRate,
    NonNegativeTime,
    Number,
    Positive,
    PositiveAngle,
    PositiveLength,
    PositiveMassFlow,
    PositivePressure,
    PositiveRate,
    PositiveTime,
    PositiveTorque,
)
from cosim.config.toml.rules import Violations, rule
from cosim.config.toml.tables import Table

_NEEDED: Final = {
    "bang_bang": ("increment",), "pi": ("proportional_gain", "integral_gain_per_s"), "python": ()
}  # fmt: skip


@final
@dataclass(frozen=True)
class PumpTable(Table):
    """A pump with a pressure switch on the gas of a chamber; acts in phases that give `pump_pressure_Pa`.

    Args:
        name: of the pump; phases give its setpoint by this name.
        chamber: that it pumps into; omitted: the only chamber.
        flow_kg_s: mass flow without counter-pressure.
        pressure_max_Pa: gauge pressure at which the flow is zero; omitted: the flow is constant.
        band_Pa: the pump switches on half of it below the setpoint, and off half of it above.
        sensor_delay_s: age of the pressure that the switch sees; rounded to whole ticks.
        vent_above_Pa: excess over the setpoint at which a valve opens, until the setpoint is reached;
            omitted: no valve.
        vent_kg_s_Pa: mass flow of the open valve per pascal of gauge pressure.
    """

    name: Name
    flow_kg_s: PositiveMassFlow
    chamber: str | None = None
    pressure_max_Pa: PositivePressure | None = None
    band_Pa: NonNegativePressure = 1e3
    sensor_delay_s: NonNegativeTime = 0.0
    vent_above_Pa: PositivePressure | None = None
    vent_kg_s_Pa: NonNegativeConductance = 0.0

    @rule
    def _vents(self) -> Violations:
        if self.vent_above_Pa is not None and self.vent_kg_s_Pa == 0.0:
            yield "vent_kg_s_Pa", "is missing: the valve of vent_above_Pa lets nothing through"


@final
@dataclass(frozen=True)
class WinchTable(Table):
    """Winches of one kind, which wind cables to the lengths that phases and controllers command.

    Args:
        name: of the winch.
        cables: names of the cables.
        one_motor: whether one drum winds all of them by the same length, against the sum of their tensions,
            as one motor closes three fingers; if not, each cable has a motor.
        step_angle_rad: of the motor, per commanded (micro)step.
        gear_ratio: turns of the motor per turn of the drum.
        drum_radius_m: to the middle of the cable.
        step_rate_per_s: highest rate of steps.
        stall_torque_Nm: of the motor; above it steps are lost.
    """

    name: Name
    cables: Annotated[tuple[str, ...], Len(min_length=1)]
    step_angle_rad: PositiveAngle
    drum_radius_m: PositiveLength
    step_rate_per_s: PositiveRate
    stall_torque_Nm: PositiveTorque
    gear_ratio: Positive = 1.0
    one_motor: bool = False

    @property
    def step_m(self) -> float:
        """Length of cable per step."""
        return self.step_angle_rad * self.drum_radius_m / self.gear_ratio

    @property
    def speed_m_s(self) -> float:
        """Highest speed of the cable."""
        return self.step_rate_per_s * self.step_m

    @property
    def stall_force_N(self) -> float:
        """Sum of the tensions on a drum above which steps are lost."""
        return self.stall_torque_Nm * self.gear_ratio / self.drum_radius_m


@final
@dataclass(frozen=True)
class ControllerTable(Table):
    """A controller with a fixed rate, which acts in the phases that name it.

    Args:
        name: of the controller; phases give its setpoint by this name.
        kind: "bang_bang": raises or lowers its output by `increment` per period; "pi": proportional and
            integral; "python": a function passed to `cosim.run(..., controllers={name: controller})`.
        period_s: between two samples, a whole number of ticks; the command holds in between.
        measures: quantity that it keeps at its setpoint; "tip_position_m" has the `tip_path` or `tip_target`
            of the phase as its setpoint, with kind "pi" and commands "flange_twist".
        commands: its output; "flange_twist": a translation of the flange in addition to its planned motion.
        cables: that it moves, all alike.
        sensors: names of sensors whose readings it receives in place of the exact values.
        increment: bang_bang: change of the output per period, in the output's unit.
        band: bang_bang: width about the setpoint in which the output stays, in the measured unit.
        proportional_gain: pi: output per error.
        integral_gain_per_s: pi: output per error and second.
        output_min: lowest output.
        output_max: highest output; omitted: none.
    """

    name: Name
    kind: Literal["bang_bang", "pi", "python"]
    period_s: PositiveTime
    measures: Literal["bending_angle_rad", "tip_height_m", "tip_position_m"] = "bending_angle_rad"
    commands: Literal["cable_tension_N", "cable_shortening_m", "flange_twist"] = "cable_tension_N"
    cables: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    increment: Positive | None = None
    band: NonNegative = 0.0
    proportional_gain: NonNegative | None = None
    integral_gain_per_s: NonNegativeRate | None = None
    output_min: Number = 0.0
    output_max: Number | None = None

    @property
    def follows_tip(self) -> bool:
        """Whether it moves the flange so that the tip follows the phase's tip target or path."""
        return self.kind != "python" and self.measures == "tip_position_m"

    @rule
    def _has_what_its_kind_needs(self) -> Violations:
        for key in [key for key in _NEEDED[self.kind] if getattr(self, key) is None]:
            yield key, f"is missing; kind '{self.kind}' needs it"

    @rule
    def _has_a_range(self) -> Violations:
        if self.kind == "python":
            return
        if self.output_max is not None and self.output_max <= self.output_min:
            yield "output_max", f"{self.output_max:g} must be above output_min, {self.output_min:g}"
        if self.commands == "cable_tension_N" and self.output_min < 0.0:
            yield "output_min", f"{self.output_min:g} N: a cable cannot push, give 0 or more"
