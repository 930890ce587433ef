"""Schema of the wires of a scenario: `[[wire]]` in the file.

A wire is a row of capsules joined by ball joints that resist bending. Its first point may be held by an
object, such as a spool on a hinge, and its last one tied to another. It touches robots, soft robots, the
floor and objects, but not itself. Soft robots feel it from 2 mm of radius on: what is thinner than twice the
depth of contact slips through the film.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

from annotated_types import Interval, Len

from cosim.config.toml.constraints import Colour, Name, NonNegative, Positive, Vector3

COPPER: tuple[float, float, float, float] = (0.72, 0.45, 0.20, 1.0)


@final
@dataclass(frozen=True)
class WireTable:
    """A thin flexible body that cannot stretch; its bodies are called NAME/1, NAME/2, ...

    Args:
        name: of the wire, in the recording and in results.
        rgba: colour: red, green, blue, opacity.
        points_m: polyline along which it lies at first, world.
        radius_m: of its capsules.
        segments: their number, evenly spaced along the polyline; each must be longer than thick.
        mass_kg: of all of it.
        bending_stiffness_Nm2: flexural rigidity EI, the same against twist.
        bending_damping_Nm2s: the same for rates.
        straight: without load it is straight; otherwise it keeps the shape that it has at first.
        first: object that holds its first point, elastically clamped; omitted: the end is free.
        last: object to which its last point is tied, free to turn; omitted: the end is free.
        friction: coefficient of sliding.
    """

    name: Name
    points_m: Annotated[tuple[Vector3, ...], Len(min_length=2)]
    radius_m: Positive
    mass_kg: Positive
    segments: Annotated[int, Interval(ge=1, le=500)] = 20
    bending_stiffness_Nm2: NonNegative = 0.0
    bending_damping_Nm2s: NonNegative = 0.0
    straight: bool = False
    first: str | None = None
    last: str | None = None
    rgba: Colour = COPPER
    friction: NonNegative = 0.5
