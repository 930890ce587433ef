"""Says at every tick or increment of a run what is asked of the robot, and measures the run for it.

Where rigid bodies are, by name.

Measures a run: what controllers see, and what `Simulation.measure` returns.

How controllers move the flange besides the plan: twists of its reference, as motions of the joints.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array, Pose, Wrench, cross, length, rotations_from_quaternions
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.devices.controller import Command, Measurement
from cosim.devices.device_report import ActuationReport
from cosim.devices.drives import CableDrive
from cosim.errors import InputError
from cosim.plan.chamber_gas import ChamberGas
from cosim.plan.commands import RobotCommand, SoftCommand
from cosim.plan.joint_path import JointReference
from cosim.soft.elements.cable import stretch_at


@final
class BodyPoses(Mapping[str, Pose]):
    """World from each of some rigid bodies, by name; a pose is made when it is asked for.

    Args:
        names: (bodies,).
        positions: (bodies, 3) [m].
        quaternions: (bodies, 4), (w, x, y, z); nobody writes to either.
    """

    def __init__(self, names: tuple[str, ...], positions: Array, quaternions: Array) -> None:
        self._names, self._positions, self._quaternions = names, positions, quaternions

    def __getitem__(self, name: str) -> Pose:
        if name not in self._names:
            raise KeyError(f"there is no rigid body '{name}'; there are: {', '.join(self._names)}")
        k = self._names.index(name)
        (rotation,) = rotations_from_quaternions(self._quaternions[k : k + 1])
        return Pose(rotation, self._positions[k])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        """Return what a dictionary of the poses would."""
        return repr(dict(self))


@final
@dataclass(frozen=True)
class StepToTake:
    """The tick or increment that is to be taken.

    Args:
        phase: its index.
        done: steps of the phase at its end, at least one.
        begin_s: simulated time at its start.
        length_s: of it.
    """

    phase: int
    done: int
    begin_s: float
    length_s: float


@final
@dataclass(frozen=True)
class RobotState:
    """What of a run is seen besides the soft side, at the start of a step.

    Args:
        time_s: simulated time.
        flange: world_from_flange.
        flange_twist: (6,) [m/s, rad/s], linear then angular, of its origin, world axes.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s].
        joint_torque: (joints,) [N m], that the servos gave in the last tick.
        wrench: that the soft robot exerts on the flange, about its origin, world axes.
        flange_jacobian: (6, joints), from joint speeds to the twist of the flange's origin, world axes.
        contact_force: (3,) [N] of the soft robot on each rigid body in the last tick, world axes, by name.
        body_pose: world from each rigid body, by name.
    """

    time_s: float
    flange: Pose
    flange_twist: Array
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    wrench: Wrench
    flange_jacobian: Array
    contact_force: Mapping[str, Array]
    body_pose: Mapping[str, Pose]


@final
@dataclass(frozen=True)
class CommandsAhead:
    """What n ticks in a row ask for.

    Args:
        joints: what the servos follow, n rows.
        soft: what the soft robot is asked for at the end of each; the same object where nothing changes.
    """

    joints: JointReference
    soft: tuple[SoftCommand, ...]


class CommandSource(ABC):
    """Asks things of the robot; a run knows nothing else of what it is to do."""

    @abstractmethod
    def begin_phase(self, phase: int) -> None:
        """Begin a phase, by its index; nothing moves at this instant."""

    @abstractmethod
    def next(self, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        """Return what is asked for in a step, which is then taken.

        Args:
            step: that is to be taken.
            see: looks at the robot as it is at the start of the step.
        """

    def ahead(self, phase: int, done: int, most: int | None = None) -> CommandsAhead | None:
        """Return what a tick and some after it ask for; None where that depends on what happens in them.

        Args:
            phase: index of their phase.
            done: ticks of the phase at the end of the first.
            most: ticks that are of use; None for as many as cost little.
        """
        return None

    @abstractmethod
    def cable_tension_N(self, phase: int, done: int) -> tuple[float, ...]:
        """Return the tensions that a step asks for, as far as is known before it; for messages."""

    def report(self, flange: Pose) -> ActuationReport | None:
        """Return what devices do at present, seen from a flange, world_from_flange; None without any."""
        return None

    def parts(self) -> dict[str, Any]:
        """Return what the next steps depend on, by name: objects that keep that in one attribute, `state`.

        A state is a frozen dataclass, which is replaced when it changes. The soft side is restored before it.
        """
        return {}


class SteeredCommands(CommandSource):
    """Can be commanded from outside, and knows what there is to measure of what it commands."""

    @abstractmethod
    def command(self, command: Command, ticks: int) -> None:
        """Take up a command for the ticks to come.

        Args:
            command: see there.
            ticks: within which its values are to be reached, at least one.

        Raises:
            InputError: it asks for what there is not, or what cannot be.
            InstabilityError: a number is not finite.
        """

    @abstractmethod
    def measured(self, robot: RobotState, tension_N: Array, sensors: Sequence[str] = ()) -> Measurement:
        """Return what is measured of the run between two ticks.

        Args:
            robot: besides the soft side.
            tension_N: (cables,) of the last tick.
            sensors: names of those whose readings take the place of the truth.

        Raises:
            InputError: there is no such sensor.
        """

    @abstractmethod
    def sensed(
        self, see: Callable[[], RobotState], tension_N: Array, seed: int | None = None
    ) -> tuple[Array, Array]:
        """Let the sensors read the run, once after every tick.

        Returns:
            Readings and truth, both (readings,); empty where there are no sensors.

        Args:
            see: looks at the robot as it is.
            tension_N: (cables,) of the last tick.
            seed: of the run, with which the sensors begin; None: they continue.
        """


class ChangedCommands(CommandSource):
    """Changes what another source asks for; a subclass with a state adds itself to `parts`.

    Args:
        given: the other source.
    """

    def __init__(self, given: CommandSource) -> None:
        self.given = given

    @abstractmethod
    def changed(self, command: RobotCommand, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        """Return what is asked for in place of a command.

        Args:
            command: of the other source.
            step: that is to be taken.
            see: looks at the robot as it is at the start of the step.
        """

    def begin_phase(self, phase: int) -> None:
        self.given.begin_phase(phase)

    def next(self, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        return self.changed(self.given.next(step, see), step, see)

    def cable_tension_N(self, phase: int, done: int) -> tuple[float, ...]:
        return self.given.cable_tension_N(phase, done)

    def report(self, flange: Pose) -> ActuationReport | None:
        return self.given.report(flange)

    def parts(self) -> dict[str, Any]:
        return self.given.parts()


def measured(
    soft: SoftSide,
    robot: RobotState,
    gas: ChamberGas,
    cables: Mapping[str, Mapping[str, float]],
    *,
    setpoint: float | None = None,
    limits: tuple[str, ...] = (),
) -> Measurement:
    """Return what is measured of a run.

    Args:
        soft: side, in its present state.
        robot: the rest, at the same time.
        gas: in the chambers.
        cables: those fields of a measurement that are by cable.
        setpoint: see `Measurement`.
        limits: the same.
    """
    body, state = soft.body, soft.state
    contents = [gas.content(k) for k in range(len(soft.pressures_Pa))]
    direction = body.tip_direction(state.positions)
    return Measurement(
        time_s=robot.time_s,
        setpoint=setpoint,
        tip_position=body.tip_position(state.positions),
        tip_direction=direction,
        tip_twist=ring_twist(state.positions[body.tip], state.velocities[body.tip]),
        bending_angle_rad=bending_angle(direction, robot.flange),
        pressure_Pa=tuple(soft.pressures_Pa),
        volume_m3=tuple(soft.volumes_m3),
        gas_kg=tuple(None if content is None else content.mass_kg for content in contents),
        joint_position=robot.joint_position,
        joint_velocity=robot.joint_velocity,
        joint_torque=robot.joint_torque,
        flange=robot.flange,
        flange_twist=robot.flange_twist,
        flange_wrench=robot.wrench,
        contact_force_N=robot.contact_force,
        body_pose=robot.body_pose,
        limits=limits,
        sensors={},
        tip_wanted=None,
        **cables,
    )


def measured_cables(
    names: Sequence[str], drives: Sequence[CableDrive], positions: Array, tension_N: Sequence[float] | None
) -> dict[str, dict[str, float]]:
    """Return those fields of a measurement that are by cable.

    Args:
        names: of the cables.
        drives: of each.
        positions: (n, 3) [m].
        tension_N: of each cable, where the drives do not drive them; None: they do.
    """
    lengths = [drive.cable.length(positions) for drive in drives]
    if tension_N is None:
        tension_N = [drive.tension_N(positions) for drive in drives]
        unstretched = [drive.unstretched_m(positions) for drive in drives]
    else:
        rows = zip(drives, tension_N, lengths, strict=True)
        unstretched = [long - stretch_at(pull, drive.cable.stiffness_N_m) for drive, pull, long in rows]
    columns = {"cable_tension_N": tension_N, "cable_length_m": lengths, "cable_unstretched_m": unstretched}
    return {key: dict(zip(names, map(float, column), strict=True)) for key, column in columns.items()}


def bending_angle(tip_direction: Array, flange: Pose) -> float:
    """Return the angle [rad] between the tip's direction (3,) and the flange's z axis."""
    axis = flange.rotation[:, 2]
    return float(np.arctan2(length(cross(axis, tip_direction)), axis @ tip_direction))


def ring_twist(positions: Array, velocities: Array) -> Array:
    """Return the twist (6,) [m/s, rad/s] about the centre of some nodes that is nearest to how they move.

    With r from the centre, v = V + w x r in the least squares: sum (r.r 1 - r r^T) w = sum r x (v - V).

    Args:
        positions: (n, 3) [m].
        velocities: (n, 3) [m/s].
    """
    count = len(positions)
    linear = velocities.sum(axis=0) / count
    away, moving = positions - positions.sum(axis=0) / count, velocities - linear
    spread = float((away * away).sum()) * np.eye(3) - away.T @ away
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = (away.T @ moving).tolist()  # the sum of r v^T
    moment = np.array([yz - zy, zx - xz, xy - yx])
    if np.linalg.det(spread) > _FLAT * spread.trace() ** 3:
        return np.concatenate([linear, np.linalg.solve(spread, moment)])
    # nodes in a line say nothing of turns about it
    return np.concatenate([linear, np.linalg.lstsq(spread, moment, rcond=1e-9)[0]])


_FLAT: Final = 1e-6
"""Of the determinant of nodes' spread to the cube of its trace, at most 1/27: below, they are in a line."""
_SMALLEST: Final = 1e-2
"""Of a Jacobian's singular values to its largest, below which no motion of the joints is asked for."""
_MISSED: Final = 1e-6


@final
class FlangeOffset:
    """The joints' reference, moved off the plan; where nothing moves it further, it stays off.

    Args:
        joints: how many.
    """

    def __init__(self, joints: int) -> None:
        self.state: Array = np.zeros(joints)
        """By how much it is off, (joints,) [rad]."""

    def moved(
        self,
        planned: JointReference,
        twist: tuple[float, ...] | None,
        see: Callable[[], RobotState],
        step_s: float,
    ) -> JointReference:
        """Return what the servos follow in a tick.

        Args:
            planned: at its start.
            twist: (6,) [m/s, rad/s] of the flange's origin, world axes, besides the plan; None for none.
            see: looks at the robot as it is.
            step_s: length of the tick.

        Raises:
            InputError: no motion of the joints moves the flange like that.
        """
        if twist is None:
            if not self.state.any():
                return planned
            return JointReference(planned.position + self.state, planned.velocity, planned.acceleration)
        rate = joint_rate(see().flange_jacobian, np.array(twist))
        position, velocity = planned.position + self.state, planned.velocity + rate
        self.state = self.state + step_s * rate
        return JointReference(position, velocity, planned.acceleration)


def joint_rate(jacobian: Array, twist: Array) -> Array:
    """Return the smallest joint speeds (joints,) [rad/s] that move the flange by a twist.

    Args:
        jacobian: (6, joints).
        twist: (6,) [m/s, rad/s].

    Raises:
        InputError: there are none, or only with the arm near a singular configuration.
    """
    if not jacobian.shape[1]:
        raise InputError("the flange is commanded to move, but robot = 'none' has no joints to move it")
    rate = np.asarray(np.linalg.lstsq(jacobian, twist, rcond=_SMALLEST)[0])
    if length(jacobian @ rate - twist) > _MISSED * length(twist):
        raise InputError(
            f"the flange is commanded to move with the twist {np.round(twist, 4).tolist()}, which the arm "
            "cannot follow in its present configuration: it is near a singular one; keep away from there, or "
            "begin where the arm is bent (start.flange)"
        )
    return rate
