"""The loads between both sides as one vector in newtons: flange first, then each body that can be touched."""

from __future__ import annotations

from typing import final

import numpy as np

from cosim.base.frames import Array, Wrench, cross
from cosim.coupling.half_ticks import LEVER_M
from cosim.coupling.schemes.interface import Interface

UNIT = np.array([1.0, 1.0, 1.0, LEVER_M, LEVER_M, LEVER_M])


@final
class InterfaceLoads:
    """Reads and writes the loads of an interface, about points that stay where they were when a tick began.

    A vector holds (force, torque / lever), world axes, of the flange about its origin, then of each body that
    can be touched and can move about its centre of mass. `points` (1 + b, 3) [m] are those places.

    Args:
        interface: between the sides.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        bodies, contact = interface.scene.bodies, interface.contact
        touchable = np.zeros(0, np.int64) if contact is None else np.unique(contact.query.body)
        self.bodies = touchable[bodies.movable(touchable)]
        self.points = np.zeros((1 + len(self.bodies), 3))

    def __len__(self) -> int:
        return 6 * len(self.points)

    def begin(self) -> None:
        """Take the present places as points of reference."""
        scene = self._interface.scene
        self.points[0] = scene.flange_pose.translation
        self.points[1:] = scene.bodies.centers(self.bodies)

    def answered(self) -> Array:
        """Return the loads (n,) with which the soft side has answered in its last step."""
        loads = np.zeros((1 + len(self.bodies), 6))
        origin = self._interface.scene.flange_pose.translation
        wrench = self._interface.wrench.moved(self.points[0] - origin)
        loads[0, :3], loads[0, 3:] = wrench.force, wrench.torque
        touched = self._interface.touched
        if len(touched.bodies):
            mine = np.isin(touched.bodies, self.bodies)
            place = 1 + np.searchsorted(self.bodies, touched.bodies[mine])
            loads[place, :3] = touched.force[mine]
            loads[place, 3:] = touched.torque[mine] - cross(self.points[place], touched.force[mine])
        return np.asarray((loads / UNIT).reshape(-1))

    def apply(self, vector: Array) -> None:
        """Let loads (n,) act on the rigid side in the step in progress."""
        scene, loads = self._interface.scene, UNIT * vector.reshape(-1, 6)
        scene.apply_flange_wrench(Wrench(loads[0, :3], loads[0, 3:]))
        world = self.about_world(vector)[1:]
        scene.bodies.apply(self.bodies, world[:, :3], world[:, 3:])

    def flange_wrench(self, vector: Array) -> Wrench:
        """Return what of loads (n,) acts on the flange, at its present origin, world axes."""
        wrench = Wrench(vector[:3], LEVER_M * vector[3:6])
        return wrench.moved(self._interface.scene.flange_pose.translation - self.points[0])

    def about_world(self, vector: Array) -> Array:
        """Return loads (n,) as (1 + b, 6): forces, and torques about the world's origin."""
        loads = UNIT * vector.reshape(-1, 6)
        loads[:, 3:] += cross(self.points, loads[:, :3])
        return np.asarray(loads)

    def from_world(self, loads: Array) -> Array:
        """Return the vector (n,) of loads (1 + b, 6) about the world's origin."""
        moved = np.array(loads)
        moved[:, 3:] -= cross(self.points, moved[:, :3])
        return np.asarray((moved / UNIT).reshape(-1))

    def held_fast(self) -> Array:
        """Return the load (6,) on touched bodies that cannot move, about the world's origin."""
        touched = self._interface.touched
        fast = ~np.isin(touched.bodies, self.bodies)
        return np.concatenate([touched.force[fast].sum(axis=0), touched.torque[fast].sum(axis=0)])
