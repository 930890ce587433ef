"""What is drawn of a rigid body: a plain triangle mesh, whoever made it and whoever draws it."""

from __future__ import annotations

from dataclasses import dataclass

from cosim.base.frames import Array, IntArray
from cosim.base.shown import Shown


@dataclass(frozen=True)
class BodyShape(Shown):
    """A triangle mesh fixed to a rigid body, for drawing only.

    Args:
        body: index into the names of the bodies of its scene.
        vertices: (n, 3) [m], body frame.
        triangles: (m, 3), counter-clockwise seen from outside.
        rgba: colour, components 0 to 1.
    """

    body: int
    vertices: Array
    triangles: IntArray
    rgba: tuple[float, float, float, float]
