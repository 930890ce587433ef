"""Mass, centre and inertia of a cloud of nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix
from cosim.soft.elements.mass_terms import mass_moments


@final
@dataclass(frozen=True)
class MassProperties:
    """Mass, centre and inertia of a cloud of nodes.

    Args:
        mass_kg: total.
        center: (3,) [m], world.
        inertia: (3, 3) [kg m^2], about the centre, world axes.
    """

    mass_kg: float
    center: Array
    inertia: Array

    @classmethod
    def of(cls, node_mass: Array, positions: Array) -> MassProperties:
        """Return the properties of nodes (n,) [kg] at positions (n, 3) [m]."""
        return cls.of_blocks(node_mass.reshape(-1, 1, 1), positions.reshape(-1, 1, 3))

    @classmethod
    def of_blocks(cls, mass: Array, points: Array) -> MassProperties:
        """Return the properties of blocks of points with a common mass matrix, see `mass_moments`.

        Args:
            mass: (b, k, k) [kg].
            points: (b, k, 3) [m].
        """
        moments = np.empty(9)
        total = mass_moments(mass, points, moments)
        if total <= 0.0:  # without mass, any point is a valid centre
            return cls(total, points[:, 0].mean(axis=0), np.zeros((3, 3)))
        x, y, z, xx, xy, xz, yy, yz, zz = moments.tolist()
        a, b, c = x / total, y / total, z / total
        xx, yy, zz = xx - a * x, yy - b * y, zz - c * z
        xy, xz, yz = xy - a * y, xz - a * z, yz - b * z
        inertia = np.array((yy + zz, -xy, -xz, -xy, xx + zz, -yz, -xz, -yz, xx + yy))
        return cls(total, np.array((a, b, c)), inertia.reshape(3, 3))

    def moved(self, world_from_frame: Pose) -> MassProperties:
        """Return the properties in the world, of properties given in a frame."""
        rotation = world_from_frame.rotation
        center = world_from_frame.apply(self.center[None])[0]
        return MassProperties(self.mass_kg, center, rotation @ self.inertia @ rotation.T)

    def joined(self, other: MassProperties) -> MassProperties:
        """Return the properties of two bodies that move as one."""
        mass = self.mass_kg + other.mass_kg
        offset = cross_matrix(self.center - other.center)
        center = (self.mass_kg * self.center + other.mass_kg * other.center) / mass
        reduced = self.mass_kg * other.mass_kg / mass
        return MassProperties(mass, center, self.inertia + other.inertia - reduced * offset @ offset)

    def figures(self) -> tuple[float, ...]:
        """Return (10,): mass, centre, inertia xx, yy, zz, xy, xz, yz."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.inertia.tolist()
        return (self.mass_kg, *self.center.tolist(), xx, yy, zz, xy, xz, yz)

    def in_frame(self, world_from_frame: Pose) -> tuple[Array, Array]:
        """Return centre (3,) and inertia (3, 3) in a frame's coordinates."""
        rotation = world_from_frame.rotation
        center = rotation.T.dot(self.center - world_from_frame.translation)
        return center, rotation.T.dot(self.inertia).dot(rotation)

    def spatial(self, origin: Array) -> Array:
        """Return the (6, 6) mass matrix, linear then angular, about a point (3,) [m], world axes."""
        m, (a, b, c) = self.mass_kg, (self.center - origin).tolist()
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.inertia.tolist()
        x, y, z, zero = m * a, m * b, m * c, 0.0
        xy, xz, yz = xy - x * b, xz - x * c, yz - y * c
        rows = (
            m, zero, zero, zero, z, -y,
            zero, m, zero, -z, zero, x,
            zero, zero, m, y, -x, zero,
            zero, -z, y, xx + y * b + z * c, xy, xz,
            z, zero, -x, xy, yy + x * a + z * c, yz,
            -y, x, zero, xz, yz, zz + x * a + y * b,
        )  # fmt: skip
        return np.array(rows).reshape(6, 6)
