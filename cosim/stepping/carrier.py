"""Base class of the carrier of the flange, such as an arm, for both modes of a run."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.frames import Array, Pose, Twist, Wrench
from cosim.base.solid import BodyShape, MovableBody
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.errors import SolverError
from cosim.plan.joint_path import JointReference
from cosim.reduced.sections.figures import FIGURES
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Obstacles

if TYPE_CHECKING:  # a scene without an arm does not load MuJoCo
    from cosim.base.solid import FilmInLink, LinkContact


class Carrier(ABC):
    """Carries the flange along its plan, under the loads of the soft robot.

    Statics: `set_configuration`, then `track` and `relax_under` for every increment. Dynamics:
    `set_configuration`, `couple`, then `advance`. The methods of this class are those of a carrier at rest,
    without joints and rigid bodies.
    """

    @property
    @abstractmethod
    def flange_pose(self) -> Pose:
        """World from flange."""

    @property
    def flange_twist(self) -> Twist:
        """Of the flange's origin, world axes."""
        return Twist()

    @property
    def joint_position(self) -> Array:
        """(joints,) [rad]."""
        return np.zeros(0)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Base to flange."""
        return ()

    @property
    def joint_velocity(self) -> Array:
        """(joints,) [rad/s]."""
        return np.zeros(0)

    @property
    def joint_torque(self) -> Array:
        """(joints,) [N m], of the servos in the last tick; at rest, their holding torque."""
        return np.zeros(0)

    @property
    @abstractmethod
    def wrench(self) -> Wrench:
        """Present wrench of the soft robot on the flange, at its origin, world axes; statics: zero."""

    @property
    def mounted_load(self) -> Array:
        """(6,), load of bodies next to the soft robot on the flange, as `Snapshot.mounted_load`."""
        return np.zeros(6)

    @property
    def flange_wrench(self) -> Wrench:
        """Present wrench of everything on the flange, as `Snapshot.flange_wrench`."""
        wrench, load = self.wrench, self.mounted_load
        return Wrench(wrench.force + load[:3], wrench.torque + load[3:])

    def flange_jacobian(self) -> Array:
        """Return (6, joints), from joint speeds to the twist of the flange's origin, world axes."""
        return np.zeros((6, 0))

    def hold(self, wrench: Wrench) -> Array:
        """Hold the arm at rest under a wrench on the flange; return the servos' torque (joints,)."""
        return np.zeros(0)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Rigid bodies, in the order of `body_poses`."""
        return ()

    @property
    def sliding(self) -> tuple[bool, ...]:
        """(joints,), whether a joint slides."""
        return ()

    @property
    def mounted(self) -> tuple[float, ...]:
        """Other bodies fixed to the flange, as `RunInfo.mounted`."""
        return ()

    @property
    def objects(self) -> tuple[MovableBody, ...]:
        """Movable objects, with their indices in `body_names`."""
        return ()

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        """Shapes of the rigid bodies, for drawing."""
        return ()

    @property
    @abstractmethod
    def report(self) -> Mapping[str, str]:
        """Texts on the model, by heading."""

    def body_poses(self) -> tuple[Array, Array]:
        """Return positions (bodies, 3) [m] and quaternions (bodies, 4), world from body."""
        return np.zeros((0, 3)), np.zeros((0, 4))

    @property
    def touched(self) -> ContactReport:
        """Contacts of the soft robot in the last tick."""
        return NOTHING_TOUCHED

    def linear_rigid_step(self) -> Array:
        """Return the rigid step of a tick to first order, see `rigid_jacobian`.

        Raises:
            InputError: the exchange has no linear step.
        """
        return np.zeros((0, FIGURES))

    def set_configuration(self, joints: Array) -> None:  # noqa: B027  # not every carrier has joints
        """Set joint angles (joints,) [rad], at rest."""

    @property
    def deflection(self) -> Array:
        """(joints,) [rad], deflection of the joints under load, in statics."""
        return np.zeros(0)

    def track(self, reference: Array, deflection: Array) -> None:  # noqa: B027
        """Set new references (joints,) [rad] at rest, with a guess of the deflection under load."""

    def relax_under(self, reference: Array, wrench: Wrench) -> bool:
        """Bring the joints to equilibrium with a wrench on the flange; return whether they moved."""
        return False

    @abstractmethod
    def servos(self, references: JointReference) -> ServoCommands:
        """Return the commands of the servos at n instants."""

    @abstractmethod
    def parts(self) -> dict[str, Any]:
        """Return the parts with a state, without the soft side, by name, see `restore_states`."""

    def completed(self, states: Mapping[str, Any]) -> dict[str, Any]:
        """Return saved states for the parts; parts that the saved run had are made if they are missing.

        Raises:
            InputError: the states do not fit.
        """
        return dict(states)

    def link_contacts(self, *, among_links: bool) -> "tuple[LinkContact, ...]":
        """Return contacts of the arm's links with the scene, or (`among_links`) with one another as well."""
        return ()

    def link_contacts_in(
        self, joints: Array, positions: Array, quaternions: Array
    ) -> "tuple[LinkContact, ...]":
        """Return all contacts of links with joints (joints,) [rad] and bodies as in `body_poses`."""
        return ()

    def film_in_links(self, positions: Array, joints: Array) -> "tuple[FilmInLink, ...]":
        """Return the links that nodes (n, 3) [m] of a film are in, with the arm at joints (joints,) [rad]."""
        return ()

    def with_links(self, error: SolverError) -> SolverError:
        """Return an error of a tick with the contacts of links at their last check."""
        return error

    def obstacles(self) -> Obstacles | None:
        """Return the obstacles of the soft robot's equilibria; None without any."""
        return None

    @property
    def drives_cell(self) -> bool:
        """Whether `drive_cell` must be called before every tick."""
        return False

    def drive_cell(self, phase: int, time_s: float) -> None:
        """Set the cell's joints at the end of the next tick, a time after the start of a phase."""
        raise NotImplementedError("there is no cell to drive")

    @abstractmethod
    def couple(self, wrench: Wrench) -> None:
        """Begin a dynamic run; `wrench` acts on the flange at its start."""

    def begins_in(self, points: Array) -> str:
        """Return a text on the body that a film (n, 3) [m] begins deep inside; empty for none."""
        return ""

    def begin_with_others(self, servos: ServoCommands) -> None:
        """Begin a tick; its rigid step is then taken for several arms at once, before `advance`."""
        raise NotImplementedError("no other arm is in the scene")

    @abstractmethod
    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        """Advance carrier and soft robot by up to n ticks; see `Coupling.advance`."""
