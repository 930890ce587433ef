"""Tables of the sensors and cameras of a scenario: `[[sensor]]` and `[[camera]]`."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeAlias, final

from annotated_types import Interval

from cosim.config.toml.quantities import (
    Direction,
    Name,
    NonNegative,
    NonNegativeTime,
    Number,
    OneOrEach,
    Position,
    PositiveFrequency,
    Vector3,
)
from cosim.config.toml.rules import Violations, rule
from cosim.config.toml.tables import Table

SensorKind: TypeAlias = Literal[
    "pressure", "cable_length", "cable_tension", "flange_force", "flange_torque", "tip_position",
    "tip_direction", "bending_angle", "joint_position", "joint_torque",
]  # fmt: skip
JOINTS: Final = ("joint_position", "joint_torque")
"""Kinds that read the joints of an arm."""
_XYZ: Final = ("x", "y", "z")
_PARALLEL: Final = 1e-6


@final
@dataclass(frozen=True)
class SensorTable(Table):
    """A sensor: quantum * round((truth + bias + noise * n) / quantum), n normal, sampled and delayed.

    Args:
        name: of the sensor; controllers name it in `sensors`.
        kind: of the measured value, in Pa, m, N, N m or rad; forces, torques and directions along the world's
            axes.
        of: names of the chambers or cables that it measures; omitted: all. Only for kinds of these.
        noise: standard deviation of white noise, in the unit of the kind; one number for all values, or one
            for each.
        bias: constant error, in that unit; likewise.
        delay_s: age of a reading; rounded to whole ticks.
        rate_Hz: samples per second, each held until the next; omitted: one per tick.
        quantum: step between readings, in that unit; 0: none.
        seed: of the noise; sensors with equal seeds have different noise.
    """

    name: Name
    kind: SensorKind
    of: tuple[str, ...] = ()
    noise: OneOrEach[NonNegative] = 0.0
    bias: OneOrEach[Number] = 0.0
    delay_s: NonNegativeTime = 0.0
    rate_Hz: PositiveFrequency | None = None
    quantum: OneOrEach[NonNegative] = 0.0
    seed: Annotated[int, Interval(ge=0, le=2**31 - 1)] = 0

    def values(self, chambers: tuple[str, ...], cables: tuple[str, ...]) -> tuple[str, ...] | None:
        """Return the names of its values; None for kinds of the arm's joints, whose names the arm has.

        Args:
            chambers: names of the soft robot's chambers.
            cables: names of the soft robot's cables.
        """
        if self.kind in JOINTS:
            return None
        if self.kind == "bending_angle":
            return ("",)
        return self.of or self.named(chambers, cables) or _XYZ

    def named(self, chambers: tuple[str, ...], cables: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names that `of` may choose from: of chambers or cables; none for other kinds."""
        if self.kind == "pressure":
            return chambers
        return cables if self.kind in ("cable_length", "cable_tension") else ()


@final
@dataclass(frozen=True)
class CameraTable(Table):
    """A camera with pictures of colour, depth and segmentation (the body that each pixel shows).

    Args:
        name: of the camera.
        on: frame that carries it, in which its pose is given. "flange": the flange's frame; "tip": at the
            tip, z along the tip's direction; "palm": the frame of the soft robot's palm; "world".
        position_m: of the camera, in that frame.
        direction: in which it looks.
        up: direction that is up in its pictures; omitted: z, or x if it looks along z.
        size: (2,) width and height in pixels.
        fov_rad: field of view from the lower to the upper edge.
        rate_Hz: pictures per second, at most one per tick; in statics there is one of every increment.
    """

    name: Name
    on: Literal["world", "flange", "tip", "palm"] = "world"
    position_m: Position = (0.0, 0.0, 0.0)
    direction: Direction = (0.0, 0.0, 1.0)
    up: Direction | None = None
    size: tuple[Annotated[int, Interval(ge=1, le=4096)], Annotated[int, Interval(ge=1, le=4096)]] = (320, 240)
    fov_rad: Annotated[float, Interval(ge=0.01, le=3.0)] = 0.8
    rate_Hz: PositiveFrequency = 10.0

    @property
    def upward(self) -> Vector3:
        """Direction that is up in its pictures."""
        x, y, z = self.direction
        along_z = x * x + y * y <= _PARALLEL * z * z
        return self.up or ((1.0, 0.0, 0.0) if along_z else (0.0, 0.0, 1.0))

    @rule
    def _up_is_across_the_direction(self) -> Violations:
        (a, b, c), (x, y, z) = self.direction, self.upward
        across = (b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2
        if across <= _PARALLEL * (a * a + b * b + c * c) * (x * x + y * y + z * z):
            yield "up", f"{[x, y, z]} is the direction in which it looks; give another one"
