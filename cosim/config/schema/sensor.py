"""Schema of what measures a run with the faults of real sensors: `[[sensor]]`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, Literal, TypeAlias, TypeVar, final

from annotated_types import Interval

from cosim.config.toml.keys import Name, NonNegative, Positive, listing, unknown_name_message
from cosim.config.toml.reading import Told, rule

if TYPE_CHECKING:
    from cosim.config.schema.scenario import Scenario

SensorKind: TypeAlias = Literal[
    "pressure", "cable_length", "cable_tension", "flange_force", "flange_torque", "tip_position",
    "tip_direction", "bending_angle", "joint_position", "joint_torque",
]  # fmt: skip
Value = TypeVar("Value")
PerValue: TypeAlias = Value | tuple[Value, ...]
"""One for all values of a sensor, or one for each."""
_XYZ: Final = ("x", "y", "z")
_RATE_ROUNDING: Final = 1e-9


@final
@dataclass(frozen=True)
class SensorTable:
    """A sensor: quantum * round((truth + bias + noise * n) / quantum), n normal, held and late.

    Args:
        name: of the sensor; controllers name it in `sensors`.
        kind: what it measures, in Pa, m, N, N m or rad; forces, torques and directions along the world's
            axes.
        of: names of the chambers or cables that it measures; omitted: all. Other kinds have no names.
        noise: standard deviation of white noise, in the unit of what is measured; one for all values, or one
            for each.
        bias: constant error, in that unit; likewise.
        delay_s: age of a reading; rounded to whole ticks.
        rate_Hz: samples per second, each held until the next; omitted: one a tick.
        quantum: step between readings, in that unit; 0: none.
        seed: of the noise; two sensors of one seed have different noise.
    """

    name: Name
    kind: SensorKind
    of: tuple[str, ...] = ()
    noise: PerValue[NonNegative] = 0.0
    bias: PerValue[float] = 0.0
    delay_s: NonNegative = 0.0
    rate_Hz: Positive | None = None
    quantum: PerValue[NonNegative] = 0.0
    seed: Annotated[int, Interval(ge=0, le=2**31 - 1)] = 0

    def values(self, scenario: Scenario) -> tuple[str, ...] | None:
        """Return the names of what it reads; None: of the arm's joints, which the scenario does not name."""
        if self.kind in ("joint_position", "joint_torque"):
            return None
        if self.kind == "bending_angle":
            return ("",)
        return self.of or self._named(scenario) or _XYZ

    def _named(self, scenario: Scenario) -> tuple[str, ...]:
        robot = scenario.soft_robot
        if self.kind == "pressure":
            return robot.chamber_names()
        return robot.cable_names() if self.kind in ("cable_length", "cable_tension") else ()

    @rule
    def _measures_what_there_is(self, scenario: Scenario) -> Told:
        names = self._named(scenario)
        if self.of and not names:
            yield "of", f"is for chambers and cables; kind '{self.kind}' has none of them: leave it out"
        elif len(set(self.of)) < len(self.of):
            yield "of", "names something twice"
        for name in [name for name in self.of if names and name not in names][:1]:
            what = "chamber" if self.kind == "pressure" else "cable"
            yield "of", unknown_name_message(what, name, names)
        if self.kind in ("joint_position", "joint_torque") and scenario.robot == "none":
            yield "kind", f"'{self.kind}' needs an arm; robot = 'none' has no joints"
        if self.kind in ("cable_length", "cable_tension") and not names:
            yield "kind", f"'{self.kind}' needs cables; the soft robot has none"

    @rule
    def _has_a_number_for_each_value(self, scenario: Scenario) -> Told:
        values = self.values(scenario)
        for key in ("noise", "bias", "quantum"):
            given = getattr(self, key)
            if values is not None and isinstance(given, tuple) and len(given) != len(values):
                names = f" ({listing(values)})" if values[0] else ""
                yield key, f"has {len(given)} entries; the sensor reads {len(values)} values{names}"

    @rule
    def _samples_at_ticks(self, scenario: Scenario) -> Told:
        tick_s = scenario.clock.tick_s
        if self.rate_Hz is not None and self.rate_Hz * tick_s > 1.0 + _RATE_ROUNDING:
            yield "rate_Hz", f"{self.rate_Hz:g} is more than one sample a tick; at most {1.0 / tick_s:g}"
