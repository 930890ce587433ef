"""Solids of rigid bodies, as distances are measured from them; shapes that are drawn; what a link touches."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, Shown

SolidShape: TypeAlias = Literal[
    "box", "sphere", "capsule", "cylinder", "ellipsoid", "plane", "hull", "surface"
]


@final
@dataclass(frozen=True)
class Solid:
    """A shape fixed to a rigid body.

    Args:
        body: index among the bodies of its scene.
        name: of the body, or of what it carries.
        shape: a plane is all that is below it; a hull is the convex one of its vertices; a surface is made of
            triangles, with nothing inside.
        size: (3,) half dimensions [m], as MuJoCo has them.
        pose: body from shape.
        vertices: (n, 3) [m], of a hull or a surface, shape frame.
        triangles: (m, 3), of a surface.
    """

    body: int
    name: str
    shape: SolidShape
    size: Array = field(default_factory=lambda: np.zeros(3))
    pose: Pose = field(default_factory=Pose)
    vertices: Array = field(default_factory=lambda: np.zeros((0, 3)))
    triangles: IntArray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))

    @property
    def radius_m(self) -> float:
        """Bound on how far its points are from the body's origin [m]; of a plane, which cannot move, 0."""
        if self.shape == "plane":
            return 0.0
        if len(self.vertices):
            return float(np.linalg.norm(self.pose.apply(self.vertices), axis=1).max())
        # a capsule's caps go beyond its half length
        return float(np.linalg.norm(self.pose.translation) + self.size.sum())


@final
@dataclass(frozen=True)
class FilmInLink:
    """Where a film is in a link of the arm that carries it.

    Args:
        link: its name.
        depth_m: of the deepest node.
        node: this.
    """

    link: str
    depth_m: float
    node: int


@final
@dataclass(frozen=True)
class LinkContact:
    """A link that touches something.

    Args:
        link: its name.
        other: of an object, of the floor, or of a link.
        depth_m: how far they overlap, of the deepest point.
        movable: whether the other one can move, links not counted.
    """

    link: str
    other: str
    depth_m: float
    movable: bool


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
