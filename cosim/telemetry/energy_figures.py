"""The energy balance of a run as it is saved: works so far, and the last tick."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.names import LOST, PUT_IN, TERMS, WORKS

KINETIC: Final = 0
"""Index of the kinetic energy in the sums of a tick."""


@final
@dataclass(frozen=True)
class EnergyRow:
    """The last tick, with which the next one is compared.

    Args:
        motion: see `fill_motion`.
        sums: (COLUMNS,).
        length: (s,) [m] of cable segments.
        seen: (columns,), volumes [m^3], pressures [Pa], tensions [N], wrench, pose of the flange.
        begun: positions [m] and velocities [m/s] before the last tick, if it was taken in substeps.
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
        ticks: number of ticks.
        last: last tick; None before the first.
    """

    works: tuple[float, ...] = (0.0,) * len(WORKS)
    done: float = 0.0
    elastic: float = 0.0
    ticks: int = 0
    last: EnergyRow | None = None

    def figures(self, elastic_J: Callable[[Array], float]) -> dict[str, float]:
        """Return the balance since the start for the summary.

        Args:
            elastic_J: positions (n, 3) [m] of the film's nodes -> elastic energy.
        """
        if self.last is None:
            return {}
        elastic = np.array([elastic_J(self.last.motion[0]) - self.elastic])
        kinetic, done = self.last.sums[KINETIC, None], np.array([self.done])
        terms = balance(np.array([self.works]), elastic, kinetic, done)
        return dict(zip(TERMS, terms[0].tolist(), strict=True))


def balance(works: Array, elastic: Array, kinetic: Array, done: Array) -> Array:
    """Return works (k, works) with the terms that follow from them, (k, terms) [J]."""
    numerical = done - kinetic
    signed = np.array([float(name in PUT_IN) - float(name in LOST) for name in WORKS])
    rest = works @ signed - elastic - kinetic - numerical
    return np.column_stack((works, elastic, kinetic, numerical, rest))
