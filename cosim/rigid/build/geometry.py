"""One solid shape of a rigid body, and how much it encloses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.base.triangle_mesh import TriangleMesh
from cosim.errors import InputError

SIZES = {
    "box": ("edge x", "edge y", "edge z"),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length between the centres of its caps"),
    "ellipsoid": ("half axis x", "half axis y", "half axis z"),
    "mesh": (),
    "plane": ("edge x", "edge y"),
}


@dataclass(frozen=True)
class Geometry:
    """A solid of one shape, somewhere on its body.

    Args:
        shape: one of `SIZES`; axes of cylinder, capsule and the plane's normal are its z.
        size_m: full dimensions [m], in the order that `SIZES` says.
        position_m: (3,) [m], of its centre, body frame; of a mesh: of the origin of its vertices.
        quaternion: (w, x, y, z), body from geometry.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.
        relative_density: its share of the body's mass goes with this times its volume.
        mesh: of shape "mesh".
        convex: of shape "mesh": each of its shells is touched as its convex hull; otherwise soft robots touch
            the surface itself, by a table of distances, and rigid bodies the hull of the whole.

    Raises:
        InputError: unknown shape, wrong number of dimensions, or a value outside its bounds.
    """

    shape: str
    size_m: tuple[float, ...] = ()
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    rgba: tuple[float, float, float, float] = (0.75, 0.55, 0.35, 1.0)
    friction: float = 0.8
    relative_density: float = 1.0
    mesh: TriangleMesh | None = None
    convex: bool = True

    def __post_init__(self) -> None:
        if self.shape not in SIZES:
            raise InputError(f"unknown shape {self.shape!r}; there are {', '.join(SIZES)}")
        if len(self.size_m) != len(SIZES[self.shape]):
            wanted = ", ".join(SIZES[self.shape]) or "no size_m"
            raise InputError(f"a {self.shape} takes {wanted}; got {len(self.size_m)} numbers")
        if (self.shape == "mesh") != (self.mesh is not None):
            raise InputError("a mesh goes with shape 'mesh', and with no other")
        if not all(np.isfinite(s) and s > 0.0 for s in self.size_m):
            raise InputError(f"size_m is {self.size_m}; every dimension must be above 0")
        if not (np.isfinite(self.friction) and self.friction >= 0.0):
            raise InputError(f"friction is {self.friction}; it must be finite and not negative")
        if not (np.isfinite(self.relative_density) and self.relative_density > 0.0):
            raise InputError(f"relative_density is {self.relative_density}; it must be above 0")
        if not (np.all(np.isfinite(self.quaternion)) and np.linalg.norm(self.quaternion) > 1e-6):
            raise InputError(f"quaternion is {self.quaternion}; it must not be zero")
        if not np.all(np.isfinite(self.position_m)):
            raise InputError(f"position_m is {self.position_m}; it must be finite")

    @property
    def volume_m3(self) -> float:
        """Enclosed volume [m^3]; 0 for a plane."""
        if self.mesh is not None:
            return self.mesh.volume_m3
        s = self.size_m
        match self.shape:
            case "box":
                return s[0] * s[1] * s[2]
            case "sphere":
                return 4.0 / 3.0 * np.pi * s[0] ** 3
            case "cylinder":
                return np.pi * s[0] ** 2 * s[1]
            case "capsule":
                return np.pi * s[0] ** 2 * (s[1] + 4.0 / 3.0 * s[0])
            case "ellipsoid":
                return 4.0 / 3.0 * np.pi * s[0] * s[1] * s[2]
            case _:
                return 0.0
