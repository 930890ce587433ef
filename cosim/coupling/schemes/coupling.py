"""Interface of the exchange schemes between arm and soft robot."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from cosim.base.frames import Wrench
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.soft.body.loads import Loads


class Coupling(ABC):
    """Advances arm and soft robot together.

    Args:
        interface: between them.
    """

    def __init__(self, interface: Interface) -> None:
        self.interface = interface

    @property
    def wrench(self) -> Wrench:
        """The soft robot's present wrench on the flange, at its origin, world axes."""
        return self.interface.wrench

    def parts(self) -> dict[str, Any]:
        """Return the stateful parts besides scene and soft robot, by name, see `restore_states`."""
        return {**self.interface.parts(), "scheme": self}

    @abstractmethod
    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        """Advance both by up to n ticks, at least one; the number of ticks per call changes no result.

        Args:
            servos: commands of the n ticks.
            loads: on the soft robot at the end of each tick.

        Returns:
            The log of the finished ticks, with the error of the tick after them if that has failed.

        Raises:
            InstabilityError: the arm's state is no longer finite, in the first tick.
            ConvergenceError: the first soft step, or the first exchange, has no solution.
        """
