"""The line through the centres of a body's rings, from its base to its tip."""

from __future__ import annotations

import math

import numpy as np
from numba import int64, void

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, MATRIX, VECTOR, kernel, small_vector
from cosim.soft.body.body import SoftBody


def center_rings(body: SoftBody) -> IntArray:
    """Return the rings (rings, nodes per ring) along the centre, base to tip; those of the first copy.

    They are the body's `center_rings`, or without any the ring "base", and the tip. Where one has fewer
    nodes than another, its nodes come more than once, which keeps its centre.
    """
    given = [body.rings[name] for name in body.center_rings] or [body.rings.get("base", body.base)]
    rings = [ring for ring in (*given, body.tip) if len(ring)]
    nodes = math.lcm(*(len(ring) for ring in rings))
    return np.stack([np.tile(ring, nodes // len(ring)) for ring in rings])


def center_line_length(rings: IntArray, positions: Array) -> float:
    """Return the length [m] of the polyline through the rings' centres.

    Args:
        rings: (rings, nodes per ring), base to tip.
        positions: (n, 3) [m].
    """
    steps = np.diff(positions[rings].mean(axis=1), axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


@kernel(void(BLOCKS, int64, MATRIX, MATRIX, VECTOR))
def ring_figures(points: Array, nodes: int, center: Array, normal: Array, length: Array) -> None:
    """Fill center, normal (k, 3) and length (k,) of k shapes from points (k, n, 3).

    The first `nodes` points are the tip ring in order, sum_i (r_i - r_0) x (r_i+1 - r_0) its normal; the
    others are the polyline.
    """
    area, one, two = small_vector(3), small_vector(3), small_vector(3)
    for k in range(points.shape[0]):
        area[:] = 0.0
        for i in range(1, nodes - 1):
            for r in range(3):
                one[r] = points[k, i, r] - points[k, 0, r]
                two[r] = points[k, i + 1, r] - points[k, 0, r]
            for r in range(3):
                s, t = (r + 1) % 3, (r + 2) % 3
                area[r] += one[s] * two[t] - one[t] * two[s]
        size = np.sqrt(area[0] * area[0] + area[1] * area[1] + area[2] * area[2])
        for r in range(3):
            normal[k, r] = area[r] / size
            total = 0.0
            for i in range(nodes):
                total += points[k, i, r]
            center[k, r] = total / nodes
        length[k] = 0.0
        for i in range(nodes + 1, points.shape[1]):
            square = 0.0
            for r in range(3):
                step = points[k, i, r] - points[k, i - 1, r]
                square += step * step
            length[k] += np.sqrt(square)
