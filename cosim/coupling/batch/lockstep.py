"""Many ticks in one call: what is asked for, what comes back, and what takes them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self, final

from cosim.base.frames import Array, Mask
from cosim.coupling.batch.batch_arrays import Ticks
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.soft.body.loads import Loads


class Rows(Protocol):
    """What is asked for in n ticks, as the kernel of some soft side needs it."""

    def rows(self, first: int, end: int) -> Self:
        """Return what is asked for in some of the ticks."""


@final
@dataclass(frozen=True)
class Servos:
    """What the servos are asked for in n ticks; see `Commands`.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m].
        by_payload: (n, joints, 10).
    """

    position: Array
    velocity: Array
    torque: Array
    by_payload: Array


@final
@dataclass(frozen=True)
class LockstepProgress:
    """How far a lockstep has come in one call, and what its ticks have left.

    Args:
        ticks: what they leave; rows beyond the last one hold nothing.
        shapes: (done,) of the film, each as `SoftSide.shape_now` returns it.
        pressure_Pa: (done, chambers), gauge.
        done: how many.
        half_done: whether the next one waits for `Lockstep.finish_tick`.
        broken: whether the rigid side has become unstable in the next one; `Lockstep.advance` says so.
        stability_ratio: (n,), see `LedgerEntry`.
        algorithmic_mass: (n,), the same.
    """

    ticks: Ticks
    shapes: Sequence[Any]
    pressure_Pa: Array
    done: int
    half_done: bool
    broken: bool
    stability_ratio: Array
    algorithmic_mass: Mask


class Lockstep(ABC):
    """Advances rigid and soft side together by many ticks at once."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether the next tick may be taken in a row, so far as that is known before it."""

    @abstractmethod
    def commands(self, servos: Servos, loads: Sequence[Loads]) -> Any:
        """Return what is asked for in n ticks (`Rows`); None for loads beyond pressures and tensions."""

    @abstractmethod
    def advance(self, commands: Any, loads: Sequence[Loads]) -> LockstepProgress:
        """Advance by n ticks, or fewer where a soft step is left or the rigid side breaks down.

        Args:
            commands: of n ticks.
            loads: at their ends.

        Raises:
            InstabilityError: the rigid side is no longer finite, in the first of these ticks or before.
        """

    @abstractmethod
    def finish_tick(self, loads: Loads) -> LedgerEntry:
        """Take the soft half of a tick that `advance` has left half done.

        Args:
            loads: at its end.

        Raises:
            ConvergenceError: no solution.
        """
