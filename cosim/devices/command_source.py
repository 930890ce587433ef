"""Base classes of command sources, which return the command of every tick or increment of a run."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

from cosim.base.frames import Array, Pose
from cosim.devices.controller import Command, Measurement, RobotState
from cosim.devices.device_report import ActuationReport
from cosim.plan.commands import RobotCommand, SoftCommand
from cosim.plan.joint_path import JointReference


@final
@dataclass(frozen=True)
class StepToTake:
    """The next tick or increment.

    Args:
        phase: index of its phase.
        done: steps of the phase at its end, at least one.
        begin_s: simulated time at its start.
        length_s: its duration.
    """

    phase: int
    done: int
    begin_s: float
    length_s: float


@final
@dataclass(frozen=True)
class CommandsAhead:
    """Commands of n successive ticks.

    Args:
        joints: references of the servos, n rows.
        soft: command to the soft robot at the end of each tick; the same object if nothing changes.
    """

    joints: JointReference
    soft: tuple[SoftCommand, ...]


class CommandSource(ABC):
    """Base class of command sources. A run gets all its commands from one source."""

    @abstractmethod
    def begin_phase(self, phase: int) -> None:
        """Begin the phase with this index; commands do not change at this instant."""

    @abstractmethod
    def next(self, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        """Return the command of the next step.

        Args:
            step: the next step.
            see: returns the robot's state at the start of the step.
        """

    def ahead(self, phase: int, done: int, most: int | None = None) -> CommandsAhead | None:
        """Return the commands of a tick and some after it; None if they depend on the state in these ticks.

        Args:
            phase: index of their phase.
            done: ticks of the phase at the end of the first.
            most: largest number of ticks; None: as many as are computed at once.
        """
        return None

    @abstractmethod
    def cable_tension_N(self, phase: int, done: int) -> tuple[float, ...]:
        """Return the commanded tensions of a step, as far as they are known before it; for messages."""

    def report(self, flange: Pose) -> ActuationReport | None:
        """Return the present values of devices; None without any.

        Args:
            flange: world_from_flange.
        """
        return None

    def parts(self) -> dict[str, Any]:
        """Return the objects with a state, by name; each has its state in the attribute `state`.

        A state is a frozen dataclass, which is replaced when it changes. The soft side is restored first.
        """
        return {}


class SteeredCommands(CommandSource):
    """A command source that accepts live commands, and measures the run."""

    @abstractmethod
    def command(self, command: Command, ticks: int) -> None:
        """Set a live command for the coming ticks.

        Args:
            command: the command.
            ticks: within which its values are reached, at least one.

        Raises:
            InputError: it names a device that does not exist, or a value that is not allowed.
            InstabilityError: a number is not finite.
        """

    @abstractmethod
    def measured(self, robot: RobotState, tension_N: Array, sensors: Sequence[str] = ()) -> Measurement:
        """Return the measurement of the run between two ticks.

        Args:
            robot: state of the robot without the soft side.
            tension_N: (cables,) of the last tick.
            sensors: names of sensors whose readings replace exact values.

        Raises:
            InputError: there is no such sensor.
        """

    @abstractmethod
    def sensed(
        self, see: Callable[[], RobotState], tension_N: Array, seed: int | None = None
    ) -> tuple[Array, Array]:
        """Update the sensors, once after every tick.

        Returns:
            Readings and exact values, both (readings,); empty without sensors.

        Args:
            see: returns the robot's present state.
            tension_N: (cables,) of the last tick.
            seed: of the run, with which the sensors restart; None: they continue.
        """


class ChangedCommands(CommandSource):
    """Changes the commands of another source; a subclass with a state adds itself to `parts`.

    Args:
        given: the other source.
    """

    def __init__(self, given: CommandSource) -> None:
        self.given = given

    @abstractmethod
    def changed(self, command: RobotCommand, step: StepToTake, see: Callable[[], RobotState]) -> RobotCommand:
        """Return the changed command.

        Args:
            command: of the other source.
            step: the next step.
            see: returns the robot's state at the start of the step.
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
