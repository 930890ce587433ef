"""The energy balance of a run as it is saved: works so far, and what the next tick is compared with."""

from dataclasses import dataclass
from typing import Annotated, Protocol, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.names import LOST, PUT_IN, TERMS, WORKS

KINETIC = 0
"""Place of the kinetic energy in the sums of a tick."""


class Elastic(Protocol):
    """What tells the elastic energy of a shape."""

    def elastic(self, positions: Array) -> float:
        """Return it [J] at positions (n, 3) [m]."""


@final
@dataclass(frozen=True)
class EnergyRow:
    """What the next tick is compared with.

    Args:
        motion: see `fill_motion`.
        sums: (COLUMNS,).
        length: (s,) [m].
        seen: (columns,), volumes [m^3], pressures [Pa], tensions [N], wrench, place and axes of the flange.
        begun: positions [m] and velocities [m/s] before the last tick, if that was taken in pieces.
    """

    motion: Annotated[Array, (6, "nodes", 3)]
    sums: Annotated[Array, (6,)]
    length: Annotated[Array, ("*",)]
    seen: Annotated[Array, ("*",)]
    begun: Annotated[Array, (2, "nodes", 3)] | None = None


@final
@dataclass(frozen=True)
class EnergyFigures:
    """The balance of the ticks so far.

    Args:
        works: [J], in the order of `WORKS`.
        done: work of all forces [J], by the masses' accelerations.
        elastic: elastic energy at the start [J].
        ticks: seen.
        last: of them; None before the first.
    """

    works: tuple[float, ...] = (0.0,) * len(WORKS)
    done: float = 0.0
    elastic: float = 0.0
    ticks: int = 0
    last: EnergyRow | None = None

    def figures(self, parts: Elastic) -> dict[str, float]:
        """Return the balance since the start for the summary."""
        if self.last is None:
            return {}
        elastic = np.array([parts.elastic(self.last.motion[0]) - self.elastic])
        found = balance(np.array([self.works]), elastic, self.last.sums[KINETIC, None], np.array([self.done]))
        return dict(zip(TERMS, found[0].tolist(), strict=True))


def balance(works: Array, elastic: Array, kinetic: Array, done: Array) -> Array:
    """Return works (k, works) and what follows from them (k, terms) [J]."""
    numerical = done - kinetic
    signed = np.array([float(name in PUT_IN) - float(name in LOST) for name in WORKS])
    rest = works @ signed - elastic - kinetic - numerical
    return np.column_stack((works, elastic, kinetic, numerical, rest))
