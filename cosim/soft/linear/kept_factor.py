"""A factorisation that serves later solutions as well, and what Newton's method saves of itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

from cosim.base.frames import Array
from cosim.soft.linear.linear_solver import FactorState
from cosim.soft.linear.pattern import BlockPattern


@final
@dataclass(frozen=True)
class KeptFactor:
    """For which problem, and at which flange rotation, the factorisation in store was made."""

    kind: float
    frame: Annotated[Array, (3, 3)]


@final
@dataclass(frozen=True)
class NewtonState:
    """What a solver carries from one solution to the next: kept factors change the iterates.

    Args:
        kept: what the factorisation was made for; None where none is kept.
        factor: the factorisation; None where none is kept.
        gradient: (n, 3) [N], at the last solution.
        wide: pattern of the factorisation where films touched one another; None for the body's own.
    """

    kept: KeptFactor | None
    factor: FactorState | None
    gradient: Annotated[Array, ("nodes", 3)]
    wide: BlockPattern | None = None
