"""What may touch in a step, the scene and the film itself, for a kernel that adds both as further terms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDEX_TABLE, MATRIX, VECTOR
from cosim.soft.contact.obstacle_contact import TOUCHED, TouchedPlanes, nothing_touched


class PairRows(NamedTuple):
    """The arrays of `FilmPairs`; `widths` (2,) [m] are those of its law, `out` (k, 5) is filled.

    A row of `out` receives normal force [N], distance [m], and the force on the point (3,) [N].
    """

    nodes: IntArray
    weights: Array
    stiffness: Array
    friction: Array
    foot: Array
    normal: Array
    stretch: Array
    widths: Array
    out: Array


class Touching(NamedTuple):
    """What may touch.

    Args:
        planes: of the scene.
        call: address of the kernel that adds pairs of films; 0 for none.
        pairs: of films.
    """

    planes: TouchedPlanes
    call: int
    pairs: PairRows


PAIRS = types.NamedTuple(
    (INDEX_TABLE, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, MATRIX, VECTOR, MATRIX), PairRows
)
TOUCHING = types.NamedTuple((TOUCHED, types.int64, PAIRS), Touching)


def nothing_touching() -> Touching:
    """Return what stands for nothing that may touch."""
    three, six, none = np.zeros((0, 3)), np.zeros((0, 6), np.int64), np.zeros(0)
    pairs = PairRows(six, three, none, none, three, three, three, np.ones(2), np.zeros((0, 5)))
    return Touching(nothing_touched(), 0, pairs)
