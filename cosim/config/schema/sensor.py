"""Schema of what measures a run with the faults of real sensors, and of what looks at it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeAlias, TypeVar, final

from annotated_types import Interval

from cosim.config.toml.keys import Direction, Name, NonNegative, Positive, Vector3
from cosim.config.toml.reading import Told, rule

SensorKind: TypeAlias = Literal[
    "pressure", "cable_length", "cable_tension", "flange_force", "flange_torque", "tip_position",
    "tip_direction", "bending_angle", "joint_position", "joint_torque",
]  # fmt: skip
Value = TypeVar("Value")
PerValue: TypeAlias = Value | tuple[Value, ...]
"""One for all values of a sensor, or one for each."""
JOINTS: Final = ("joint_position", "joint_torque")
"""Kinds that read the joints of an arm."""
_XYZ: Final = ("x", "y", "z")
_PARALLEL: Final = 1e-6


@final
@dataclass(frozen=True)
class SensorTable:
    """A sensor: quantum * round((truth + bias + noise * n) / quantum), n normal, held and late.

    Args:
        name: of the sensor; controllers name it in `sensors`.
        kind: of the measured value, in Pa, m, N, N m or rad; forces, torques and directions along the world's
            axes.
        of: names of the chambers or cables that it measures; omitted: all. Other kinds have no names.
        noise: standard deviation of white noise, in the unit of the kind; one for all values, or one
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

    def values(self, chambers: tuple[str, ...], cables: tuple[str, ...]) -> tuple[str, ...] | None:
        """Return the names of what it reads; None: of the arm's joints, which a scenario does not name.

        Args:
            chambers: names of the soft robot's.
            cables: the same.
        """
        if self.kind in JOINTS:
            return None
        if self.kind == "bending_angle":
            return ("",)
        return self.of or self.named(chambers, cables) or _XYZ

    def named(self, chambers: tuple[str, ...], cables: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of chambers or cables that `of` may choose from; none for other kinds."""
        if self.kind == "pressure":
            return chambers
        return cables if self.kind in ("cable_length", "cable_tension") else ()


@final
@dataclass(frozen=True)
class CameraTable:
    """A camera that sees colours, depths, and what every pixel belongs to.

    Args:
        name: of the camera.
        on: what carries it, and in whose axes it is placed. "flange": the flange's frame; "tip": at the tip,
            z along the tip's direction; "palm": the frame of the soft robot's palm; "world".
        position_m: of it.
        direction: in which it looks.
        up: that is up in its pictures; omitted: z, or x where it looks along z.
        size: (2,) width and height in pixels.
        fov_rad: field of view from the lower to the upper edge.
        rate_Hz: pictures per second, at most one a tick; in statics there is one of every increment.
    """

    name: Name
    on: Literal["world", "flange", "tip", "palm"] = "world"
    position_m: Vector3 = (0.0, 0.0, 0.0)
    direction: Direction = (0.0, 0.0, 1.0)
    up: Direction | None = None
    size: tuple[Annotated[int, Interval(ge=1, le=4096)], Annotated[int, Interval(ge=1, le=4096)]] = (320, 240)
    fov_rad: Annotated[float, Interval(ge=0.01, le=3.0)] = 0.8
    rate_Hz: Positive = 10.0

    @property
    def upward(self) -> Vector3:
        """What is up in its pictures."""
        x, y, z = self.direction
        along_z = x * x + y * y <= _PARALLEL * z * z
        return self.up or ((1.0, 0.0, 0.0) if along_z else (0.0, 0.0, 1.0))

    @rule
    def _knows_what_is_up(self) -> Told:
        (a, b, c), (x, y, z) = self.direction, self.upward
        across = (b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2
        if across <= _PARALLEL * (a * a + b * b + c * c) * (x * x + y * y + z * z):
            yield "up", f"{[x, y, z]} is the direction in which it looks; give another one"
