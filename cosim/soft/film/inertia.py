"""The inertia term of an implicit step, with losses: energy = sum_i c_i |x_i - y_i|^2 / 2."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

from cosim.base.frames import Array
from cosim.soft.film.strain_rates import StrainRates


@final
@dataclass(frozen=True)
class Inertia:
    """The inertia term of a step: coefficient c, target y.

    Args:
        coefficient: (n,) [N/m], mass over the squared step, plus damping.
        target: (n, 3) [m], position of each node in free flight.
        step_s: length of the step; infinite for a proximal term outside time.
        closely: whether the step is solved below the tolerance of an ordinary one.
        rates: viscous losses of the materials; None for none.
    """

    coefficient: Array
    target: Array
    step_s: float = math.inf
    closely: bool = False
    rates: StrainRates | None = None

    @cached_property
    def kind(self) -> float:
        """A number [N/m] that identifies tangents with this term: the sum of the coefficients."""
        return float(self.coefficient.sum())
