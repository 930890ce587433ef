"""Base class of scenes that exchange loads with a soft robot, whether cosim or a user's loop steps MuJoCo."""

from abc import ABC, abstractmethod
from typing import Any, Final, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose, SixNumbers, Twist, Wrench
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.bodies import Bodies
from cosim.rigid.scene.flange import MountedFrame
from cosim.rigid.scene.mobility import jacobian_of, mobility

_NO_JOINTS: Final = np.zeros(0)
_DEEP_M: Final = 1e-3  # from which on a film is thrown out of what it begins in


class CoupledScene(ABC):
    """A scene with a soft robot on its flange; a view into MuJoCo's model and state.

    `flange` is the frame that the soft robot hangs on, `bodies` are those that its film may touch. Arrays
    over joints (dofs,) are of the degrees of freedom that move the flange.

    Args:
        model: compiled scene.
        data: its state.
        tick_s: length of a tick [s].
    """

    flange: MountedFrame
    bodies: Bodies
    joint_rows: tuple[Array, Array, Array] = (_NO_JOINTS, _NO_JOINTS, _NO_JOINTS)
    """Views of positions (joints,) [rad], speeds [rad/s] and torques of servos [N m]."""
    _resisting: Array

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, tick_s: float) -> None:
        self._model, self._data, self._tick_s = model, data, tick_s
        self.body_names = tuple(model.body(i).name for i in range(model.nbody))
        # MuJoCo's arrays stay where they are in memory; looking one up costs as much as its copy
        self.place_rows: tuple[Array, Array] = data.xpos, data.xquat
        """Views of positions (bodies, 3) [m] and quaternions (bodies, 4), world from body."""
        self.mounted: Array = np.zeros(6)
        """Force [N] and torque [N m] of what is fixed next to the soft robot on the flange, at its origin,
        world axes: weight, inertia and contacts, mean over the last rigid step."""

    @property
    def tick_s(self) -> float:
        """Length of a tick [s]."""
        return self._tick_s

    @property
    def substeps(self) -> int:
        """How many steps of MuJoCo a tick may be cut into."""
        return 1

    def go_finely(self, left: int | None) -> None:  # noqa: B027  # most scenes do not cut ticks
        """Let ticks be single steps of MuJoCo, so many left in a tick of the clock; None: whole ticks."""

    @property
    @abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints, base to flange; none where joints are not the exchange's to move."""

    @property
    @abstractmethod
    def joint_acceleration(self) -> Array:
        """(dofs,) [rad/s^2], of the last finished step."""

    @abstractmethod
    def apply_flange_wrench(self, wrench: Wrench) -> None:
        """Set the load on the flange from now on: at the flange origin, world axes."""

    @abstractmethod
    def received_wrench(self) -> SixNumbers:
        """Return the load on the flange at present, about the world's origin, read back."""

    @abstractmethod
    def apply_joint_torque(self, torque: Array) -> None:
        """Set a torque (dofs,) [N m] from now on, besides all else."""

    @final
    @property
    def flange_pose(self) -> Pose:
        """world_from_flange."""
        return self.flange.pose

    @final
    @property
    def flange_twist(self) -> Twist:
        """Velocity of the flange, at its origin, world axes."""
        return self.flange.twist

    @final
    def body_poses(self) -> tuple[Array, Array]:
        """Return positions (bodies, 3) [m] and quaternions (bodies, 4) (w, x, y, z), world from body."""
        position, quaternion = self.place_rows
        return position.copy(), quaternion.copy()

    @final
    def mobility(self, bodies: IntArray | None = None) -> Array:
        """Return W = J (M + h D)^-1 J^T (6 + 6 b, 6 + 6 b): velocity changes per impulse, see `mobility`.

        Of the flange, then of bodies (b,) if given; M with armature, but without what is carried; h the tick,
        D of servos and joints.
        """
        added, carried = np.diag(self._resisting), self.bodies.carried
        added[carried.square] -= carried.on_arm
        jacobian = self.flange.whole_jacobian()
        if bodies is not None:
            jacobian = np.concatenate([jacobian, jacobian_of(self._model, self._data, bodies)])
        return mobility(self._model, self._data, jacobian, added)

    def step_arm(self, position: Array, velocity: Array, torque: Array) -> None:
        """Take the rigid step of a tick under the loads that are set; everything readable follows.

        Args:
            position: (joints,) [rad], of the servos.
            velocity: (joints,) [rad/s], at which that continues within the tick.
            torque: (joints,) [N m], feedforward.

        Raises:
            InstabilityError: the state is no longer finite.
        """
        raise NotImplementedError("somebody else steps this scene")

    def read_touch(self, touch: Array) -> None:  # noqa: B027  # most scenes have no such sensors
        """Fill columns 1 and 2 of touch (bodies, 3): contacts that sensors count, see `TickColumns`."""

    def check(self) -> None:  # noqa: B027  # whoever else steps a scene sees to it
        """Raise InstabilityError where MuJoCo has warned: the state is no longer finite."""

    @abstractmethod
    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distances to everything that collides (and is fixed), but what carries the flange."""

    def begins_in(self, points: Array) -> str:
        """Return what a film begins deep inside of, and could only be thrown out of; empty for nothing.

        Args:
            points: (n, 3) [m], of the film, world.
        """
        query = self.contact_query()
        hits = query.distances(points, -_DEEP_M)
        if not len(hits):
            return ""
        k = int(np.argmin(hits.distance))
        geom = int(query.geoms[hits.shape[k]])
        name = self._model.geom(geom).name or self.body_names[self._model.geom_bodyid[geom]]
        return f"the soft robot begins {-1e3 * hits.distance[k]:.1f} mm deep in {name!r}"

    @property
    @abstractmethod
    def state(self) -> Any:
        """A copy of all that the next step depends on; everything readable follows one that is set."""

    @state.setter
    @abstractmethod
    def state(self, state: Any) -> None:
        """Set it.

        Raises:
            InputError: the state is of a scene with other bodies or joints.
        """
