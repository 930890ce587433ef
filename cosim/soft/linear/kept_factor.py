"""A factorisation that serves later solutions as well, and what Newton's method saves of itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.linear.linear_solver import FactorState
from cosim.soft.linear.pattern import BlockPattern

EXTRA_MAX: Final = 8
"""Iterations beyond one a solution that have cost as much as a new factorisation: it is made."""


@final
@dataclass(frozen=True)
class KeptFactor:
    """For which problem, and at which flange rotation, a part of the factorisation in store was made.

    Args:
        kind: see `Problem.kind`.
        frame: world from flange.
        extra: iterations with it beyond one a solution.
    """

    kind: float
    frame: Annotated[Array, (3, 3)]
    extra: int = 0


KeptParts = tuple[KeptFactor | None, ...]


def nothing_kept(apart: IntArray) -> KeptParts:
    """Return what stands for no part kept of those whose nodes begin at `apart` (k + 1,)."""
    return (None,) * (len(apart) - 1)


def kept_of_all(parts: KeptParts, kind: float) -> KeptFactor | None:
    """Return for what all parts were made, if for a problem of one kind and at one rotation.

    None as well where one of them is not to serve on.
    """
    first = parts[0]
    for other in parts:
        if other is None or other.kind != kind or other.extra >= EXTRA_MAX:
            return None
        if first is None or not np.array_equal(other.frame, first.frame):
            return None
    return first


def served(kept: KeptFactor | None, iterations: int) -> KeptFactor | None:
    """Return what is kept after it has served a solution for some iterations."""
    extra = max(0, iterations - 1)
    return replace(kept, extra=kept.extra + extra) if kept is not None and extra else kept


@final
@dataclass(frozen=True)
class NewtonState:
    """What a solver carries from one solution to the next: kept factors change the iterates.

    Args:
        kept: what each part of the factorisation was made for; None where none is kept.
        factor: the factorisation; None where none is kept of any part.
        gradient: (n, 3) [N], at the last solution.
        wide: pattern of the factorisation where films touched one another; None for the body's own.
    """

    kept: tuple[KeptFactor | None, ...]
    factor: FactorState | None
    gradient: Annotated[Array, ("nodes", 3)]
    wide: BlockPattern | None = None
