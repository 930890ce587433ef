"""Schema of the rigid objects of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, final

from cosim.scenario.constraints import Colour, Length, Name, NonNegative, Positive, Quaternion, Vector3


@final
@dataclass(frozen=True)
class SceneObject:
    """A rigid body of the scene.

    Args:
        size_m: box: three edge lengths; sphere: radius; cylinder, capsule: radius and length.
        position_m: of its centre, world.
        quaternion: (w, x, y, z), world from object; normalised on use.
        mass_kg: omitted = fixed to the world.
        friction: coefficient of sliding.
    """

    name: Name
    shape: Literal["box", "sphere", "cylinder", "capsule"]
    size_m: Annotated[tuple[Positive, ...], Length(at_least=1, at_most=3)]
    position_m: Vector3
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    mass_kg: Positive | None = None
    rgba: Colour = (0.55, 0.57, 0.60, 1.0)
    friction: NonNegative = 0.8
