"""What contact with the scene adds to rows of ticks, as arrays of documented shapes."""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDICES, MATRIX, REAL, VECTOR
from cosim.coupling.contact.contact_arrays import (
    END,
    MEMORY,
    SHAPES,
    TIES,
    EndRows,
    MemoryRows,
    ShapeRows,
    Ties,
)
from cosim.coupling.contact.film_search import SEARCH, Search
from cosim.soft.contact.obstacle_contact import TOUCHED, TouchedPlanes

REMEMBERED, TOUCHES, POINTS, NEAR, AGE, ASKS = range(6)
"""Places in `ContactRow.counts`: contacts remembered, contacts in the last tick, how many of them are of the
film's points, whether anything was near, ticks since bodies were weighed, whether they are to be."""


class ContactNumbers(NamedTuple):
    """Numbers of contact.

    Args:
        behind: how far behind the film a feature counts [m].
        per_area: stiffness of a point [N/m^3].
        of_feature: stiffness of a feature [N/m].
        renewed_above: growth of the contacts' stiffness with which bodies are to be weighed.
        renewed_after: ticks of contact after which they are.
    """

    behind: float
    per_area: float
    of_feature: float
    renewed_above: float
    renewed_after: int


class ContactRow(NamedTuple):
    """What may be touched in a row of ticks; arrays are filled from their beginnings.

    Args:
        there: whether contact is found in the row; otherwise a tick with anything near is left.
        search: for what is near.
        shapes: their poses, and what they are of.
        numbers: of contact.
        memory: of the last tick.
        kept: of the tick in progress.
        touched: contacts.
        ties: theirs.
        end: of the tick.
        applied: (bodies, 6), MuJoCo's loads on them.
        centers: (bodies, 3) [m], of their masses.
        loaded: (bodies,), 1 for those that bear a load of contact.
        free: (f,) bodies that move freely.
        touching: (f,) [N/m], stiffness of their contacts when they were weighed.
        weighed: (f,), 1 for those that were.
        handed: (7,), film's load on all bodies about the world's origin, and its size [N].
        speed: (1,) [m/s], of the film's fastest node before the step.
        counts: (6,).
        calls: (3,), see `contact_calls`.
    """

    there: bool
    search: Search
    shapes: ShapeRows
    numbers: ContactNumbers
    memory: MemoryRows
    kept: MemoryRows
    touched: TouchedPlanes
    ties: Ties
    end: EndRows
    applied: Array
    centers: Array
    loaded: IntArray
    free: IntArray
    touching: Array
    weighed: IntArray
    handed: Array
    speed: Array
    counts: IntArray
    calls: IntArray


_NUMBERS = types.NamedTuple((REAL, REAL, REAL, REAL, types.int64), ContactNumbers)
CONTACT_ROW = types.NamedTuple(
    (
        types.boolean, SEARCH, SHAPES, _NUMBERS, MEMORY, MEMORY, TOUCHED, TIES, END, MATRIX, MATRIX, INDICES,
        INDICES, VECTOR, INDICES, VECTOR, VECTOR, INDICES, INDICES,
    ),
    ContactRow,
)  # fmt: skip
