"""Energies of a film at given shapes: elastic energy, and power lost by its materials."""

from functools import cached_property
from typing import Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.film.film import FilmPotential
from cosim.soft.film.strain_rates import StrainRates


@final
class FilmEnergies:
    """Elastic energy and losses of a body's film at given shapes; its terms are built on first use.

    A pickled copy builds them again.

    Args:
        body: with the film.
        tick_s: [s], of the run.
    """

    def __init__(self, body: SoftBody, tick_s: float) -> None:
        self._body, self._tick_s = body, tick_s

    def __reduce__(self) -> tuple[Any, ...]:
        return FilmEnergies, (self._body, self._tick_s)

    @cached_property
    def _summed(self) -> tuple[FilmPotential, Array]:
        film = FilmPotential(self._body)
        return film, film.fresh(self._body.first_memory())

    @cached_property
    def _rates(self) -> StrainRates | None:
        return StrainRates.of(self._body)

    def elastic(self, positions: Array) -> float:
        """Return the elastic energy [J] at positions (n, 3) [m]."""
        (film, memory), x = self._summed, np.array(positions, order="C")
        loads = Loads((), (0.0,) * len(self._body.cables), (0.0, 0.0, 0.0))
        return film.evaluate(x, loads, film.losses_at(x, loads), memory, hessian=False)

    def resisted(self, positions: Array, two_steps: bool) -> float:
        """Return the power [W] that materials lose in a tick.

        Args:
            positions: (3, n, 3) [m], two ticks before its end, one before, and at the end.
            two_steps: whether its step has a two-step scheme.
        """
        rates = self._rates
        if rates is None:
            return 0.0
        span = 2.0 * self._tick_s / 3.0 if two_steps else self._tick_s
        rates.begin(positions[1].copy(), positions[0].copy() if two_steps else None, span)
        return 2.0 * rates.potential(positions[2].copy()) / span
