"""A wire: capsules in a row, joined by ball joints that resist bending."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.errors import InputError


@dataclass(frozen=True)
class Wire:
    """A thin flexible body through given points.

    Between neighbours of length l acts the moment -(EI / l) angle - (damping / l) angular velocity, in
    every direction, so that many segments bend like a beam of flexural rigidity EI; twist the same. It cannot
    stretch, and does not touch itself.

    Args:
        name: unique in the scene; its bodies are NAME/1, NAME/2, ...
        points_m: (n, 3) [m], world: the polyline along which it lies at first.
        radius_m: of its capsules.
        segments: their number, evenly spaced along the polyline.
        mass_kg: of all of it.
        bending_stiffness_Nm2: EI.
        bending_damping_Nm2s: the same for rates.
        straight: without load it is straight; otherwise as it lies at first.
        first: object that holds its first point, elastically clamped; None: the end is free.
        last: object to which its last point is tied, free to turn; None: the end is free.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.

    Raises:
        InputError: a value outside its bounds, or segments that are not longer than thick.
    """

    name: str
    points_m: tuple[tuple[float, float, float], ...]
    radius_m: float
    segments: int
    mass_kg: float
    bending_stiffness_Nm2: float = 0.0
    bending_damping_Nm2s: float = 0.0
    straight: bool = False
    first: str | None = None
    last: str | None = None
    rgba: tuple[float, float, float, float] = (0.72, 0.45, 0.20, 1.0)
    friction: float = 0.5

    def __post_init__(self) -> None:
        where = f"wire {self.name!r}"
        for name in ("radius_m", "mass_kg", "segments"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{where}: {name} is {getattr(self, name)}; it must be above 0")
        for name in ("bending_stiffness_Nm2", "bending_damping_Nm2s", "friction"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise InputError(f"{where}: {name} is {getattr(self, name)}; it must not be negative")
        if len(self.points_m) < 2 or not np.isfinite(self.points_m).all():
            raise InputError(f"{where}: needs at least two points of finite coordinates")
        shortest = float(self.lengths_m.min())
        if not shortest > 2.0 * self.radius_m:
            raise InputError(
                f"{where}: its shortest segment is {shortest:.3g} m, not longer than thick "
                f"({2.0 * self.radius_m:g} m); take fewer than {self.segments} segments"
            )

    @property
    def knots(self) -> Array:
        """Ends of the segments (segments + 1, 3) [m], world, evenly spaced along the polyline."""
        points = np.array(self.points_m, dtype=np.float64)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        wanted = np.linspace(0.0, along[-1], self.segments + 1)
        return np.stack([np.interp(wanted, along, points[:, r]) for r in range(3)], axis=1)

    @property
    def lengths_m(self) -> Array:
        """(segments,) [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.knots, axis=0), axis=1))

    def poses(self) -> Sequence[Pose]:
        """Return world from segment: origin at its first end, z along it, twisted as little as can be."""
        knots = self.knots
        axis, rotation, poses = np.array([0.0, 0.0, 1.0]), np.eye(3), []
        for k, length in enumerate(self.lengths_m):
            ahead = (knots[k + 1] - knots[k]) / length
            rotation = rotation_from_vector(_turn(axis, ahead)) @ rotation
            axis = ahead
            poses.append(Pose(rotation, knots[k]))
        return tuple(poses)


def _turn(a: Array, b: Array) -> Array:
    """Return the shortest rotation vector (3,) [rad] that turns unit vector a to b."""
    normal = np.cross(a, b)
    sine = float(np.linalg.norm(normal))
    angle = float(np.arctan2(sine, a @ b))
    if sine > 1e-12:
        return np.asarray(normal * (angle / sine))
    aside = np.eye(3)[int(np.argmin(np.abs(a)))]
    across = np.cross(a, aside)
    return np.asarray(across * (angle / np.linalg.norm(across)))
