"""Records of rigid bodies: solids to which distances are measured, shapes that are only drawn, and contacts
that a link of the arm has with the film or with a body.
"""

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
        name: of the body, or of the part that is mounted on it.
        shape: a plane is the half space below it; a hull is the convex hull of its vertices; a surface
            consists of triangles and has no inside.
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
        """Bound on the distance of its points from the body's origin [m]; 0 for a plane, as it is fixed."""
        if self.shape == "plane":
            return 0.0
        if len(self.vertices):
            return float(np.linalg.norm(self.pose.apply(self.vertices), axis=1).max())
        # a capsule's caps go beyond its half length
        return float(np.linalg.norm(self.pose.translation) + self.size.sum())


@final
@dataclass(frozen=True)
class FilmInLink:
    """A penetration of the film into a link of the arm that carries it.

    Args:
        link: name of the link.
        depth_m: depth of the deepest node [m].
        node: index of this node.
    """

    link: str
    depth_m: float
    node: int


@final
@dataclass(frozen=True)
class LinkContact:
    """A contact of a link of the arm.

    Args:
        link: name of the link.
        other: name of the object or of the other link, or the floor.
        depth_m: depth of the deepest point [m].
        movable: whether the other one is an object that can move.
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


@final
@dataclass(frozen=True)
class MovableBody:
    """A body of a scene that loads can move.

    Args:
        body: its index.
        free: whether it hangs on no joint.
        figures: (10,) mass [kg], centre (3,) [m] in the body's frame, inertia xx, yy, zz, xy, xz, yz [kg m^2]
            about that centre, body axes.
    """

    body: int
    free: bool
    figures: tuple[float, ...]
