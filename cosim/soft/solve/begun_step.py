"""A step of a film that was begun elsewhere, as a tick of a row, and goes on where it was left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array
from cosim.soft.solve.state import SoftState


@final
@dataclass(frozen=True)
class BegunStep:
    """Where a call of `film_step` has left a step; `StepWork` and the bed hold the rest until the next call.

    Args:
        state: from which the step begins.
        x: (n, 3) [m], where its end is.
        base: (n, 3) [m], as `film_step` leaves it.
        memory: (values,), of the elements there.
        iterations: so far.
        residual: [N].
    """

    state: SoftState
    x: Array
    base: Array
    memory: Array
    iterations: int
    residual: float
