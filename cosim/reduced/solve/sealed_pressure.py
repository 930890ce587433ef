"""The pressure of sealed gas in a chain: that which it has at the volume it gives the chamber."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from cosim.base.frames import Array
from cosim.soft.elements.gas import SealedGas
from cosim.soft.solve.newton_options import Outcome

_ROUNDS_MAX = 30
_TOLERANCE = 1e-9  # of the absolute pressure
_STEP_MAX = 0.02  # the same, in one round


class Attempt(Protocol):
    """A solution at a given pressure."""

    @property
    def frames(self) -> Array:
        """(f, 4, 3)."""

    @property
    def outcome(self) -> Outcome:
        """How it ended."""


Found = TypeVar("Found", bound=Attempt)


def solve_sealed(
    gas: SealedGas,
    begin_Pa: float,
    volume: Callable[[Array], float],
    attempt: Callable[[float, Found | None], Found],
) -> Found:
    """Return the solution at the pressure that the gas has in it, found by secants.

    Args:
        gas: in the chamber.
        begin_Pa: gauge pressure to begin with.
        volume: enclosed [m^3] by frames (f, 4, 3) at the pressure of the last attempt.
        attempt: solves at a gauge pressure [Pa]; given the last solution, None for the first.
    """
    pressure, step, before = begin_Pa, 0.0, 0.0
    found = attempt(pressure, None)
    for _ in range(_ROUNDS_MAX - 1):
        if found.outcome is not Outcome.CONVERGED:
            break
        off = gas.gauge_pressure(volume(found.frames)) - pressure
        whole = abs(pressure) + gas.ambient_Pa
        if abs(off) <= _TOLERANCE * whole:
            break
        slope = (off - before) / step if step else -1.0
        # more pressure, more volume: the true slope is below -1
        step = min(max(-off / min(slope, -1.0), -_STEP_MAX * whole), _STEP_MAX * whole)
        before, pressure = off, pressure + step
        found = attempt(pressure, found)
    return found
