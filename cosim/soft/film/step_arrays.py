"""What the kernel of a film's step is given and what it leaves, as arrays of documented shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, BOOLEAN, INDICES, MATRIX, REAL, VECTOR, device_function
from cosim.soft.film.film_arrays import FILM_LOADS, SLOTS, FilmLoads, FilmSlots
from cosim.soft.linear.secant_pairs import PAIRS, SecantPairs

(
    TO_DO, LEFT, TANGENTS, RESIDUAL, ENERGY, ASKS, TRIED, SEARCHES, TRIES, SHARE, SLOPE, PAIRS_KNOWN, AGAIN,
    MOVED, SWEEPS, RUN,
) = range(16)  # fmt: skip
"""What columns of `StepWork.parts` are."""
NOTHING, EVALUATION, TANGENT, SOLUTION, EVALUATED, SOLVED, STUCK = range(7)
"""What a part asks for: the potential where kernels do not know all terms, a step with a new tangent, one
with a kept factorisation of a kind that they do not know; what it is given; that no share of it serves."""
GOES_ON, BEGINS_STEP, BEGINS = range(3)
"""How a call begins: where the last one ended; a step in time; a solution where the end of the motion is."""


class StepNumbers(NamedTuple):
    """Numbers of a step; see `StepOptions`, `NewtonOptions` and `step_begin`.

    Args:
        two_steps: whether the step looks back over two.
        h: [s].
        span: s [s].
        factor: s / (1 + alpha s) [s].
        fraction: of the gain in velocity that moves the nodes in free flight.
        tolerance: [N].
        start_tolerance: [N].
        reuse_rate: bound on a residual over the last one.
        reuse_below: [N], residual above which new tangents are made.
        step_max: [m].
        halvings: of a step along a new tangent, at most.
        potential: whether the loads have one.
        complete: whether kernels know all terms.
    """

    two_steps: bool
    h: float
    span: float
    factor: float
    fraction: float
    tolerance: float
    start_tolerance: float
    reuse_rate: float
    reuse_below: float
    step_max: float
    halvings: int
    potential: bool
    complete: bool


class StepMotion(NamedTuple):
    """Where a step begins, and where it ends: `new_...` are filled.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_x: one step earlier; of the first step: x.
        earlier_velocity: the same.
        memory: (values,), what the elements remember.
        flange: (4, 3), see `flange_axes`, at the end.
        new_x: (n, 3).
        new_velocity: (n, 3).
        new_memory: (values,).
    """

    x: Array
    velocity: Array
    earlier_x: Array
    earlier_velocity: Array
    memory: Array
    flange: Array
    new_x: Array
    new_velocity: Array
    new_memory: Array


class StepPlace(NamedTuple):
    """Where a call goes on.

    Args:
        begins: BEGINS_STEP, BEGINS, or GOES_ON where the end of the motion, the gradient and `StepWork.parts`
            are.
        reuse_max: iterations of each part with a kept factorisation at most, in all calls of a step.
        tangents_max: new tangents of each part at most, in all calls of a step.
    """

    begins: int
    reuse_max: int
    tangents_max: int


class NewTangents(NamedTuple):
    """Where a kernel assembles new tangents.

    Args:
        slots: of the film's terms, see `FilmSlots`; empty where it makes none.
        blocks: (b, 3, 3) [N/m].
        first: (parts + 1,), where the blocks of each part begin.
    """

    slots: FilmSlots
    blocks: Array
    first: IntArray


class StepWork(NamedTuple):
    """Scratch of a step; `gradient` holds what its end has.

    Args:
        calls: (9,), see `step_calls`.
        gradient: (n, 3) [N].
        solution: (1, n, 3).
        served: (2, n, 3), the last point that serves [m] and its gradient [N].
        pairs: of the steps with the kept factorisation.
        reference: (values,).
        pull: (segments,).
        parts: (parts, 16) of which each has: whether it is to be solved, iterations with a kept factorisation
            that are left, new tangents in the step, residual [N] and potential [J] where it is, what it asks
            for, the potential [J] where it tries to go; whether it searches along a new tangent's step, how
            often still, at what share of the step, and its slope [J]; pairs known, whether it tries once more
            from where it is, whether it has moved, sweeps over folds, iterations with the kept factorisation.
        more: loads that are not plain.
    """

    calls: IntArray
    gradient: Array
    solution: Array
    served: Array
    pairs: SecantPairs
    reference: Array
    pull: Array
    parts: Array
    more: FilmLoads


NUMBERS = types.NamedTuple((BOOLEAN, *(9 * [REAL]), types.int64, BOOLEAN, BOOLEAN), StepNumbers)
PLACE = types.NamedUniTuple(types.int64, 3, StepPlace)  # as numba has it where all fields are alike
NEW_TANGENTS = types.NamedTuple((SLOTS, BLOCKS, INDICES), NewTangents)
MOTION = types.NamedTuple((*(4 * [MATRIX]), VECTOR, *(3 * [MATRIX]), VECTOR), StepMotion)
WORK = types.NamedTuple(
    (INDICES, MATRIX, BLOCKS, BLOCKS, PAIRS, VECTOR, VECTOR, MATRIX, FILM_LOADS), StepWork
)


@device_function
def copy(values, to):  # type: ignore[no-untyped-def]
    """Copy values; a loop compiles in a fraction of the time of an assignment to a slice."""
    for i in range(values.shape[0]):
        to[i] = values[i]


@device_function
def copy_rows(values, to):  # type: ignore[no-untyped-def]
    """Copy the rows of a matrix with three columns."""
    for i in range(values.shape[0]):
        for r in range(3):
            to[i, r] = values[i, r]


@device_function
def move(place, share, change, x):  # type: ignore[no-untyped-def]
    """Fill x with a place to which a share of a change is added."""
    for i in range(x.shape[0]):
        for r in range(3):
            x[i, r] = place[i, r] + share * change[i, r]


def room_for_parts(count: int) -> Array:
    """Return room for what `StepWork` has of each of some parts."""
    return np.zeros((count, RUN + 1))
