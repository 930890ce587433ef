"""Scratch for the Hessians of the beams of one ring; kernels take it as one argument."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernels import allocating

COUNT: Final = 9
"""of measures."""
STRETCH, SINE, COSINE = 0, 7, 8


class BeamWork(NamedTuple):
    """Scratch for the Hessians of the m beams of a ring.

    Args:
        directors: (m, 2, 3, 3), d_k at both ends.
        measures: (m, 9), l, (c, s_2, s_3) at both ends, S, C.
        direction: (m, 3), t.
        turn: (m, 2, 2), theta_k at both ends.
        factor: (m, 2, 3), arccos(c) / (1 - c^2)^(1/2) at both ends, with two derivatives by c.
        first: (m, 9), derivative of the energy by the measures.
        second: (m, 9, 9), the same twice.
        jacobian: (m, 9, 9), of the measures by v and the turns of both nodes.
        hessian: (m, 9, 9), of the energy by these.
        pull: (3,), derivative by t at one end, or what a director meets.
        product: (9, 9), second times jacobian.
    """

    directors: Array
    measures: Array
    direction: Array
    turn: Array
    factor: Array
    first: Array
    second: Array
    jacobian: Array
    hessian: Array
    pull: Array
    product: Array


@allocating
def beam_work(m):  # type: ignore[no-untyped-def]
    """Return the scratch for m beams; what stays zero in it is zero."""
    return BeamWork(
        np.empty((m, 2, 3, 3)), np.empty((m, 9)), np.empty((m, 3)), np.empty((m, 2, 2)), np.empty((m, 2, 3)),
        np.empty((m, 9)), np.zeros((m, 9, 9)), np.zeros((m, 9, 9)), np.empty((m, 9, 9)), np.empty(3),
        np.empty((9, 9)),
    )  # fmt: skip
