"""The exchange of arm and soft body, in whatever scheme."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from cosim.base.frames import Wrench
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.soft.body.loads import Loads


class Coupling(ABC):
    """Advances arm and soft body.

    Args:
        interface: between them.
    """

    def __init__(self, interface: Interface) -> None:
        self.interface = interface

    @property
    def wrench(self) -> Wrench:
        """What the soft side exerts on the flange at present, at its origin, world axes."""
        return self.interface.wrench

    def parts(self) -> dict[str, Any]:
        """Return what the next tick depends on besides scene and soft side, by name, see `restore_states`."""
        return {**self.interface.parts(), "scheme": self}

    @abstractmethod
    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        """Advance both sides by up to n ticks, at least one; how many changes no result.

        Args:
            servos: what they are asked for.
            loads: on the soft body at the ends of the ticks.

        Returns:
            What they leave, and the error of the tick after the last one, if that has failed.

        Raises:
            InstabilityError: the rigid side is no longer finite, in the first tick.
            ConvergenceError: the first soft step, or the first exchange, has no solution.
        """
