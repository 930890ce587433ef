"""What carries the flange, as both modes of a run see it; and the simplest carrier, a held base."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from cosim.base.column import room_for
from cosim.base.columns import TickColumns
from cosim.base.frames import Array, Pose, Twist, Wrench
from cosim.base.solid import BodyShape
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.ticks import ServoCommands, TickLog, figures_of, sizes_of
from cosim.errors import SolverError
from cosim.plan.joint_path import JointPath, JointReference
from cosim.plan.static_plan import AnyFlangeMotion
from cosim.reduced.sections.figures import FIGURES
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Obstacles

if TYPE_CHECKING:  # a scene without an arm does not wait for MuJoCo
    from cosim.base.solid import FilmInLink, LinkContact


class Carrier(ABC):
    """Carries the flange along its planned way, and is acted on by the soft robot.

    Statics: `set_configuration`, then `track` and `relax_under` for every increment. Dynamics:
    `set_configuration`, `couple`, then `advance`. What a subclass leaves out is as without an arm: at rest,
    with no joints and no rigid bodies.
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
        """(joints,) [N m], that the servos gave in the last tick; at rest, their holding torque."""
        return np.zeros(0)

    @property
    @abstractmethod
    def wrench(self) -> Wrench:
        """What the soft robot exerts on the flange at present, at its origin, world axes; statics: zero."""

    @property
    def mounted_load(self) -> Array:
        """(6,), of what is fixed next to the soft robot on the flange, as `Snapshot.mounted_load`."""
        return np.zeros(6)

    @property
    def flange_wrench(self) -> Wrench:
        """What all that hangs on the flange exerts on it at present, as `Snapshot.flange_wrench`."""
        wrench, load = self.wrench, self.mounted_load
        return Wrench(wrench.force + load[:3], wrench.torque + load[3:])

    def flange_jacobian(self) -> Array:
        """Return (6, joints): the twist of the flange's origin by the joint speeds, world axes."""
        return np.zeros((6, 0))

    def hold(self, wrench: Wrench) -> Array:
        """Let the servos hold the arm at rest under a wrench on the flange; return their torque (joints,)."""
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
        """What is fixed to the flange beside the soft robot, as `RunInfo.mounted`."""
        return ()

    @property
    def objects(self) -> tuple[tuple[int, bool, tuple[float, ...]], ...]:
        """Objects that can move: place in `body_names`, if free, and figures as of `mounted`, body frame."""
        return ()

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        """What is drawn of the rigid bodies."""
        return ()

    @property
    @abstractmethod
    def report(self) -> Mapping[str, str]:
        """What is modelled of it, by heading."""

    def body_poses(self) -> tuple[Array, Array]:
        """Return positions (bodies, 3) [m] and quaternions (bodies, 4), world from body."""
        return np.zeros((0, 3)), np.zeros((0, 4))

    @property
    def touched(self) -> ContactReport:
        """What the soft robot pressed on in the last tick."""
        return NOTHING_TOUCHED

    def linear_rigid_step(self) -> Array:
        """Return the rigid step of a tick to first order, see `rigid_jacobian`.

        Raises:
            InputError: the exchange has none.
        """
        return np.zeros((0, FIGURES))

    @abstractmethod
    def set_configuration(self, joints: Array) -> None:
        """Go to joint angles (joints,) [rad], at rest."""

    @property
    def deflection(self) -> Array:
        """(joints,) [rad], by which they give way under load, in statics."""
        return np.zeros(0)

    @abstractmethod
    def track(self, reference: Array, deflection: Array) -> None:
        """Move on to new references (joints,) [rad] at rest, with a guess of the deflection under load."""

    def relax_under(self, reference: Array, wrench: Wrench) -> bool:
        """Go where the soft robot's wrench at the flange pushes it; return whether it still moved."""
        return False

    @abstractmethod
    def servos(self, references: JointReference) -> ServoCommands:
        """Return what the servos are asked for at n instants."""

    @abstractmethod
    def parts(self) -> dict[str, Any]:
        """Return what the steps to come depend on besides the soft side, by name, see `restore_states`."""

    def completed(self, states: Mapping[str, Any]) -> dict[str, Any]:
        """Return saved states of the parts, which are there as they were in the saved run from here on.

        Raises:
            InputError: the states do not fit.
        """
        return dict(states)

    def link_contacts(self, *, among_links: bool) -> "tuple[LinkContact, ...]":
        """Return where links of the arm are in what is in the scene, or (`among_links`) in one another."""
        return ()

    def link_contacts_in(self, joints: Array, places: Array, quaternions: Array) -> "tuple[LinkContact, ...]":
        """Return both with the arm at joints (joints,) [rad] and bodies as in `body_poses`."""
        return ()

    def film_in_links(self, positions: Array, joints: Array) -> "tuple[FilmInLink, ...]":
        """Return in which links of the arm at joints (joints,) [rad] nodes (n, 3) [m] of a film are."""
        return ()

    def with_links(self, error: SolverError) -> SolverError:
        """Return an error of a tick that says what links stood in, when they were last looked at."""
        return error

    def obstacles(self) -> Obstacles | None:
        """Return what an equilibrium of the soft robot may touch; None for nothing."""
        return None

    @property
    def drives_cell(self) -> bool:
        """Whether `drive_cell` comes before every tick."""
        return False

    def drive_cell(self, phase: int, time_s: float) -> None:
        """Set where the cell's joints are at the end of the tick to come, that long after a phase began."""
        raise NotImplementedError("there is no cell to drive")

    @abstractmethod
    def couple(self, wrench: Wrench) -> None:
        """Begin a lockstep run; `wrench` acts on the flange at its start."""

    def begins_in(self, points: Array) -> str:
        """Return what a film (n, 3) [m] begins deep inside of, see `CoupledScene`; empty for nothing."""
        return ""

    def begin_with_others(self, servos: ServoCommands) -> None:
        """Begin a tick, whose rigid step is then taken for several arms at once, ahead of `advance`."""
        raise NotImplementedError("no other arm is in the scene")

    @abstractmethod
    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        """Advance carrier and soft robot by up to n ticks; see `Coupling.advance`."""


@final
@dataclass(frozen=True)
class HeldBaseState:
    """What a held base feels.

    Args:
        wrench: of the soft robot on the flange, at its origin, world axes.
    """

    wrench: Wrench


@final
class HeldBase(Carrier):
    """Holds the flange where it starts: no arm, no joints, no rigid bodies.

    Args:
        soft: the soft side.
        world_from_flange: where.
        tick_s: of the lockstep clock [s].
    """

    def __init__(self, soft: SoftRobot, world_from_flange: Pose, tick_s: float) -> None:
        self._soft, self._pose, self._tick_s = soft, world_from_flange, tick_s
        self._room = room_for(TickColumns, sizes_of(joints=0, bodies=0, chambers=len(soft.pressures_Pa)))
        self.state = HeldBaseState(Wrench())
        """What the next step depends on."""

    @staticmethod
    def plan(start: Pose, ways: list[AnyFlangeMotion], blame: Callable[[int], str]) -> tuple[JointPath, ...]:
        """Return a path without joints for every phase."""
        return tuple(JointPath(np.zeros(0), None) for _ in ways)

    @property
    def flange_pose(self) -> Pose:
        return self._pose

    @property
    def wrench(self) -> Wrench:
        return self.state.wrench

    @property
    def report(self) -> Mapping[str, str]:
        return {"Arm": "none: the base is held where it starts"}

    def set_configuration(self, joints: Array) -> None:
        pass

    def track(self, reference: Array, deflection: Array) -> None:
        pass

    def couple(self, wrench: Wrench) -> None:
        self.state = HeldBaseState(wrench)

    def parts(self) -> dict[str, Any]:
        return {"base": self}

    def servos(self, references: JointReference) -> ServoCommands:
        return ServoCommands.without_payload(*[np.zeros_like(references.position)] * 3)

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        """Advance by one tick: each takes long."""
        taken = TickLog(self._room(1))
        taken.flange_position[0], taken.flange_rotation[0] = self._pose.translation, self._pose.rotation
        reply = self._soft.advance(self._pose, loads[0], self._tick_s)
        self.state = HeldBaseState(reply.wrench)
        taken.end_tick(reply, self._soft, figures_of(self._soft, reply.wrench))
        return taken
