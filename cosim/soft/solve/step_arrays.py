"""What the kernel of a film's step is given and what it leaves, as arrays of documented shapes."""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import BLOCKS, BOOLEAN, INDEX_TABLE, INDICES, MASKS, MATRIX, PLACES, REAL, VECTOR
from cosim.soft.linear.envelope_cholesky import EnvelopeArrays
from cosim.soft.linear.secant_pairs import PAIRS, SecantPairs

TO_DO, LEFT, RESIDUAL, ENERGY = range(4)
"""What columns of `StepWork.parts` are."""


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
        step_max: [m].
    """

    two_steps: bool
    h: float
    span: float
    factor: float
    fraction: float
    tolerance: float
    start_tolerance: float
    reuse_rate: float
    step_max: float


class KeptEnvelope(NamedTuple):
    """A factorisation by its envelope, and the flange's axes when each part of it was made.

    Args:
        there: (parts,), 1 where there is one, 0 for none.
        factor: see `EnvelopeArrays`.
        frame: (parts, 3, 3), world from flange.
        free: (n, 3), components that move.
    """

    there: IntArray
    factor: EnvelopeArrays
    frame: Array
    free: Mask


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
        begins: whether the step does; otherwise the end of the motion, the gradient and `StepWork.parts` are
            where it is.
        reuse_max: iterations of each part at most, in all calls of a step.
    """

    begins: bool
    reuse_max: int


class StepWork(NamedTuple):
    """Scratch of a step; `gradient` holds what its end has.

    Args:
        calls: (11,), see `step_calls`.
        gradient: (n, 3) [N].
        solution: (1, n, 3).
        served: (2, n, 3), the last point that serves [m] and its gradient [N].
        pairs: of the steps with the kept factorisation.
        reference: (values,).
        pull: (segments,).
        parts: (parts, 4) of which each has: whether it is to be solved, iterations that are left, residual
            [N] and potential [J] where it is.
    """

    calls: IntArray
    gradient: Array
    solution: Array
    served: Array
    pairs: SecantPairs
    reference: Array
    pull: Array
    parts: Array


NUMBERS = types.NamedTuple((BOOLEAN, *(8 * [REAL])), StepNumbers)
PLACE = types.NamedTuple((BOOLEAN, types.int64), StepPlace)
_FACTOR = types.NamedTuple((VECTOR, PLACES, PLACES, VECTOR, INDICES, INDEX_TABLE), EnvelopeArrays)
KEPT = types.NamedTuple((INDICES, _FACTOR, BLOCKS, MASKS), KeptEnvelope)
MOTION = types.NamedTuple((*(4 * [MATRIX]), VECTOR, *(3 * [MATRIX]), VECTOR), StepMotion)
WORK = types.NamedTuple((INDICES, MATRIX, BLOCKS, BLOCKS, PAIRS, VECTOR, VECTOR, MATRIX), StepWork)
