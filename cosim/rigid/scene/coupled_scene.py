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
    """A MuJoCo scene with a soft robot on its flange.

    `flange` is the frame of the mount, and `bodies` are the bodies that the film may touch. Arrays over
    degrees of freedom (dofs,) contain those that move the flange.

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
        # MuJoCo never moves its arrays in memory; an attribute look-up costs as much as a copy
        self.place_rows: tuple[Array, Array] = data.xpos, data.xquat
        """Views of positions (bodies, 3) [m] and quaternions (bodies, 4), world from body."""
        self.mounted: Array = np.zeros(6)
        """Force [N] and torque [N m] of bodies that are fixed on the flange beside the soft robot, at its
        origin, world axes: weight, inertia and contacts, mean over the last rigid step."""

    @property
    def tick_s(self) -> float:
        """Length of a tick [s]."""
        return self._tick_s

    @property
    def substeps(self) -> int:
        """Number of MuJoCo's steps into which a tick may be divided."""
        return 1

    def set_substep(self, left: int | None) -> None:  # noqa: B027  # most scenes do not divide ticks
        """Divide ticks into single steps of MuJoCo; `left` of them remain in the tick. None: whole ticks."""

    @property
    @abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints, base to flange; empty if the coupling does not move the joints."""

    @property
    @abstractmethod
    def joint_acceleration(self) -> Array:
        """(dofs,) [rad/s^2], of the last finished step."""

    @abstractmethod
    def apply_flange_wrench(self, wrench: Wrench) -> None:
        """Set the load on the flange: at the flange origin, world axes."""

    @abstractmethod
    def received_wrench(self) -> SixNumbers:
        """Return the load on the flange about the world's origin, as MuJoCo has it."""

    @abstractmethod
    def apply_joint_torque(self, torque: Array) -> None:
        """Set a torque (dofs,) [N m] that is added to all others."""

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

        The rows are those of the flange, then of bodies (b,) if given. M includes armature, but not the added
        inertia; h is the tick, and D the damping of servos and joints.
        """
        added, carried = np.diag(self._resisting), self.bodies.carried
        added[carried.square] -= carried.on_arm
        jacobian = self.flange.whole_jacobian()
        if bodies is not None:
            jacobian = np.concatenate([jacobian, jacobian_of(self._model, self._data, bodies)])
        return mobility(self._model, self._data, jacobian, added)

    def step_arm(self, position: Array, velocity: Array, torque: Array) -> None:
        """Take the rigid step of a tick under the present loads, and update all readable values.

        Args:
            position: (joints,) [rad], references of the servos.
            velocity: (joints,) [rad/s], of the references within the tick.
            torque: (joints,) [N m], feedforward.

        Raises:
            InstabilityError: the state is no longer finite.
        """
        raise NotImplementedError("the user's loop steps this scene")

    def read_touch(self, touch: Array) -> None:  # noqa: B027  # most scenes have no such sensors
        """Fill columns 1 and 2 of touch (bodies, 3): contacts that sensors count, see `TickColumns`."""

    def check(self) -> None:  # noqa: B027  # a scene that a user's loop steps checks in `end_step`
        """Check MuJoCo's warnings.

        Raises:
            InstabilityError: the state is no longer finite.
        """

    @abstractmethod
    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distances to all (fixed) colliding geoms, without those that carry the flange."""

    def begins_in(self, points: Array) -> str:
        """Return a message if a film begins deep inside a geom, which would eject it; empty otherwise.

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
        """A copy of the state on which the next step depends; setting it updates all readable values."""

    @state.setter
    @abstractmethod
    def state(self, state: Any) -> None:
        """Restore a state.

        Raises:
            InputError: the state is of a scene with other bodies or joints.
        """
