"""What a verification case is, and what it finds."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, final


@final
@dataclass(frozen=True)
class Figure:
    """One number against its known value.

    Args:
        quantity: what it is.
        unit: SI unit, "1" for a pure number.
        value: as computed by the soft model.
        reference: the known value.
        tolerance: largest error that passes.
        absolute: whether error and tolerance are |value - reference| in `unit`; otherwise they are
            |value - reference| / |reference|.
        observed_order: exponent with which the error falls under refinement, where it was measured.
    """

    quantity: str
    unit: str
    value: float
    reference: float
    tolerance: float
    absolute: bool = False
    observed_order: float | None = None

    @classmethod
    def refined(
        cls, quantity: str, unit: str, coarse: float, fine: float, reference: float, tolerance: float = 5e-3
    ) -> Figure:
        """Return the figure of a mesh, with the order of convergence from one half as fine."""
        order = observed_order(coarse - reference, fine - reference)
        return cls(quantity, unit, fine, reference, tolerance, observed_order=order)

    @property
    def error(self) -> float:
        """The error, relative to the reference unless the tolerance is absolute."""
        difference = float(abs(self.value - self.reference))
        if self.absolute:
            return difference
        return difference / float(abs(self.reference)) if self.reference else math.inf

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a number that is not finite never is."""
        return bool(self.error <= self.tolerance)


class Case(ABC):
    """A problem whose answer is known.

    Class attributes: `name`, as typed on the command line; `title`, one line; `source`, of the answer.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]

    @abstractmethod
    def run(self) -> tuple[Figure, ...]:
        """Solve the problem and return its figures.

        Raises:
            SolverError: it could not be solved.
        """


def observed_order(coarse_error: float, fine_error: float, ratio: float = 2.0) -> float:
    """Return log(coarse error / fine error) / log(ratio), the order of convergence.

    Args:
        coarse_error: signed or absolute error on the coarse mesh or long step.
        fine_error: the same on a mesh or step finer by `ratio`.
        ratio: of refinement.
    """
    if coarse_error == 0.0 or fine_error == 0.0:
        return math.nan
    return math.log(abs(coarse_error / fine_error)) / math.log(ratio)
