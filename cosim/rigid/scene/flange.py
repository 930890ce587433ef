"""The flange of a scene: its pose, velocity and Jacobian, the load on it, and its force sensor."""

from collections.abc import Sequence
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, Pose, SixNumbers, Twist, Wrench
from cosim.rigid.scene.arm_layout import ArmLayout, Mounting


class MountedFrame:
    """The frame that a soft robot is mounted on; a view into a scene's model and state.

    Pose and velocity are computed at most once between two calls of `moved`.

    Args:
        model: compiled scene.
        data: its state.
        mounting: the frame.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting) -> None:
        self._model, self._data, self._mounting = model, data, mounting
        self._origin, self._axes = mounting.frame(data)
        self._pose: Pose | None = None
        self._spin, self._known = np.zeros(6), False  # whether it is that of the present state

    @property
    def axes(self) -> Array:
        """(3, 3), a view, world from flange."""
        return self._axes

    @property
    def origin(self) -> Array:
        """(3,) [m], a view, world."""
        return self._origin

    def moved(self) -> None:
        """Discard pose and velocity, after MuJoCo has computed new ones."""
        self._pose, self._known = None, False

    @property
    def pose(self) -> Pose:
        """world_from_flange."""
        if self._pose is None:
            self._pose = Pose.owning(self._axes.copy(), self._origin.copy())
        return self._pose

    @property
    def spin(self) -> Array:
        """(6,), a view: angular [rad/s] then linear [m/s] velocity, at its origin, world axes."""
        if not self._known:
            at, self._known = self._mounting, True
            mujoco.mj_objectVelocity(self._model, self._data, at.kind, at.index, self._spin, False)
        return self._spin

    @property
    def twist(self) -> Twist:
        """Velocity of the flange, at its origin, world axes."""
        spin = self.spin.copy()
        return Twist.owning(spin[3:], spin[:3])

    def jacobian(self) -> Array:
        """Return J (6, dofs) with [linear; angular] = J qd, at the flange origin, world axes.

        Its columns are the degrees of freedom that move the flange.
        """
        return self.whole_jacobian()[:, self._mounting.dofs]

    def whole_jacobian(self) -> Array:
        """Return J (6, nv) for all degrees of freedom of the scene."""
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], self._origin, self._mounting.body)
        return jacobian


def about_origin(load: Sequence[float], place: Array) -> SixNumbers:
    """Return a load, force then torque, about the world's origin.

    Args:
        load: (6,) [N, N m], about `place`.
        place: (3,) [m], world.
    """
    (x, y, z, u, v, w), (a, b, c) = load, place.tolist()
    return x, y, z, u + b * z - c * y, v + c * x - a * z, w + a * y - b * x


@final
class Flange(MountedFrame):
    """The flange of an arm: a frame on a massless body, with a sensor.

    Args:
        model: compiled scene.
        data: its state.
        layout: of the arm.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout) -> None:
        super().__init__(model, data, layout.mounting)
        self._applied: Array = data.xfrc_applied[layout.mount]
        self._center: Array = data.xipos[layout.mount]
        self._sensor = data.sensordata[layout.force], data.sensordata[layout.torque]
        self._read_at = Pose()  # axes of what the sensor shows
        self._restored: Array | None = np.zeros(6)  # in place of what it shows

    def apply(self, wrench: Wrench) -> None:
        """Set the load on the flange from now on: at its origin, world axes."""
        self._applied[:3], self._applied[3:] = wrench.force, wrench.torque

    def received(self) -> SixNumbers:
        """Return the load on the flange: force, and torque about the world's origin, world axes.

        It is read back from MuJoCo, so it includes loads that others have applied.
        """
        return about_origin(self._applied.tolist(), self._center)

    def read_sensor(self) -> None:
        """Use the sensor's present reading for `measured` until the next step; call it before `moved`."""
        self._read_at, self._restored = self.pose, None

    @property
    def measured(self) -> Array:
        """Load (6,) [N, N m] of the flange on the arm at the sensor's last reading, world axes."""
        if self._restored is not None:
            return self._restored
        # MuJoCo reports the load of the arm on the flange, which is the opposite
        return -np.concatenate([self._read_at.rotation @ part for part in self._sensor])

    @measured.setter
    def measured(self, load: Array) -> None:
        self._restored = load
