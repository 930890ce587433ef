"""What the contacts of the film with the scene did, body by body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.contact.obstacle_contact import ContactForces, ContactPlanes


@final
@dataclass(frozen=True)
class ContactReport:
    """What the contacts of one tick did.

    Args:
        bodies: (b,) touched bodies.
        force: (b, 3) [N] on each, world axes.
        torque: (b, 3) [N m] on each, about the world's origin.
        count: contact points that press.
        normal_force_N: sum over them.
        depth_m: of the deepest.
    """

    bodies: Annotated[IntArray, ("b",)]
    force: Annotated[Array, ("b", 3)]
    torque: Annotated[Array, ("b", 3)]
    count: int
    normal_force_N: float
    depth_m: float

    @classmethod
    def of(cls, planes: ContactPlanes, found: ContactForces) -> ContactReport:
        """Return the report of contact points that know their bodies.

        Args:
            planes: what was touched.
            found: the contact points at the end of the tick.
        """
        # a point that has just come off may still rub: friction is bounded by the last tick's normal force
        acting = np.abs(found.force).max(axis=1) > 0.0
        point, force = found.point[acting], -found.force[acting]
        bodies, place = np.unique(planes.body[acting], return_inverse=True)
        total, torque = np.zeros((len(bodies), 3)), np.zeros((len(bodies), 3))
        np.add.at(total, place, force)
        np.add.at(torque, place, np.cross(point, force))
        return cls(bodies, total, torque, found.pressing, float(found.normal_force.sum()), found.depth_m)

    def on_each(self, bodies: int) -> Array:
        """Return the force on each of so many bodies (bodies, 3) [N], world axes."""
        forces = np.zeros((bodies, 3))
        forces[self.bodies] = self.force
        return forces


NOTHING_TOUCHED: Final = ContactReport(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), 0, 0.0, 0.0)
