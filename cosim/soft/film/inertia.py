"""Inertia and losses of an implicit step as an elastic bed: energy = sum_i c_i |x_i - y_i|^2 / 2."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

from cosim.base.frames import Array
from cosim.soft.film.strain_rates import StrainRates


@final
@dataclass(frozen=True)
class Inertia:
    """The bed of a step: coefficient c, target y.

    Args:
        coefficient: (n,) [N/m], mass over the squared step, plus damping.
        target: (n, 3) [m], where free flight would take each node.
        step_s: length of the step; infinite for a bed that is no step in time.
        closely: whether the step is solved below the tolerance of an ordinary one.
        rates: what materials resist rates of strain with in the step; None where none does.
    """

    coefficient: Array
    target: Array
    step_s: float = math.inf
    closely: bool = False
    rates: StrainRates | None = None

    @cached_property
    def kind(self) -> float:
        """A number [N/m] that tells apart tangents of different steps: the sum of the bed."""
        return float(self.coefficient.sum())
