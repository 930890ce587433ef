"""Says at every tick or increment of a run what is asked of the robot, and measures the run for it.

Where rigid bodies are, by name.

Measures a run: what controllers see, and what `Simulation.measure` returns.

How controllers move the flange besides the plan: twists of its reference, as motions of the joints.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

from cosim.base.frames import Array, Pose, Wrench
from cosim.devices.controller import Command, Measurement
from cosim.devices.device_report import ActuationReport
from cosim.plan.commands import RobotCommand, SoftCommand
from cosim.plan.joint_path import JointReference


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
