"""The flange of a compiled scene: where it is, how it moves, what acts on it and what it measures."""

from __future__ import annotations

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, Pose, SixNumbers, Twist, Wrench
from cosim.rigid.scene.layout import ArmLayout

_SITE = int(mujoco.mjtObj.mjOBJ_SITE)


@final
class Flange:
    """A view into a scene's model and state.

    Pose and twist are made once between two calls of `moved`; MuJoCo's arrays stay where they are in memory,
    so they are looked up once.

    Args:
        model: compiled scene.
        data: its state.
        layout: where the arm sits in it.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout) -> None:
        self._model, self._data, self._layout = model, data, layout
        self._axes = data.site_xmat[layout.site].reshape(3, 3)
        self._origin = data.site_xpos[layout.site]
        self._applied: Array = data.xfrc_applied[layout.mount]
        self._center: Array = data.xipos[layout.mount]
        self._sensor = data.sensordata[layout.force], data.sensordata[layout.torque]
        self._pose: Pose | None = None
        self._twist: Twist | None = None
        self._read_at = Pose()  # axes of what the sensor shows
        self._restored: Array | None = np.zeros(6)  # in place of what it shows

    def moved(self) -> None:
        """Forget pose and twist; MuJoCo has computed new ones."""
        self._pose = self._twist = None

    @property
    def pose(self) -> Pose:
        """world_from_flange."""
        if self._pose is None:
            self._pose = Pose.owning(self._axes.copy(), self._origin.copy())
        return self._pose

    @property
    def twist(self) -> Twist:
        """Velocity of the flange, at its origin, world axes."""
        if self._twist is None:
            twist = np.empty(6)
            mujoco.mj_objectVelocity(self._model, self._data, _SITE, self._layout.site, twist, False)
            self._twist = Twist.owning(twist[3:], twist[:3])
        return self._twist

    def jacobian(self) -> Array:
        """Return J (6, joints) with [linear; angular] = J qd, at the flange origin, world axes."""
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._layout.site)
        return jacobian[:, self._layout.dofs]

    def apply(self, wrench: Wrench) -> None:
        """Set the load on the flange from now on: at its origin, world axes."""
        self._applied[:3], self._applied[3:] = wrench.force, wrench.torque

    def received(self) -> SixNumbers:
        """Return what acts on the flange now: force, and torque about the world's origin, world axes.

        Read back from MuJoCo, so it holds whatever has been applied by whomever.
        """
        (x, y, z, u, v, w), (a, b, c) = self._applied.tolist(), self._center.tolist()
        return x, y, z, u + b * z - c * y, v + c * x - a * z, w + a * y - b * x

    def stepped(self, began: Pose) -> None:
        """Take note of a step that was taken elsewhere, and read the sensor as it was in it.

        Args:
            began: pose of the flange at its beginning.
        """
        self.moved()
        self._read_at, self._restored = began, None

    def read_sensor(self) -> None:
        """Take over what the sensor shows until the next step; it has not `moved` since it was computed."""
        self._read_at, self._restored = self.pose, None

    @property
    def measured(self) -> Array:
        """Load (6,) that what hangs on the flange put on the arm when its sensor was read, world axes."""
        if self._restored is not None:
            return self._restored
        # MuJoCo reports what the arm exerts on the flange, the wanted load is its opposite.
        return -np.concatenate([self._read_at.rotation @ part for part in self._sensor])

    @measured.setter
    def measured(self, load: Array) -> None:
        self._restored = load
