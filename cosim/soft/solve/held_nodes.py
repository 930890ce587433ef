"""Nodes that the flange holds, in kernels: where it has them, and what they put on it.

The flange is a (4, 3) array: its origin [m], then its three axes, world.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.kernels import INDICES, MASKS, MATRIX, VECTOR, kernel


class HeldNodes(NamedTuple):
    """The arrays of a `Clamp`.

    Args:
        nodes: (k,).
        offsets: (k, 3) [m], flange frame.
        components: (k, 3), world components that are held.
    """

    nodes: IntArray
    offsets: Array
    components: Mask


HELD = types.NamedTuple((INDICES, MATRIX, MASKS), HeldNodes)


def flange_axes(pose: Pose) -> Array:
    """Return a flange's pose as kernels see it (4, 3)."""
    flange = np.empty((4, 3))
    flange[0], flange[1:] = pose.translation, pose.rotation.T
    return flange


@kernel(types.void(HELD, MATRIX, MATRIX))
def place_held(held: HeldNodes, flange: Array, x: Array) -> None:
    """Put the held components of x (n, 3) [m] where the flange has them."""
    for k in range(held.nodes.shape[0]):
        for r in range(3):
            if held.components[k, r]:
                place = held.offsets[k, 0] * flange[1, r] + held.offsets[k, 1] * flange[2, r]
                x[held.nodes[k], r] = place + held.offsets[k, 2] * flange[3, r] + flange[0, r]


@kernel(types.void(HELD, MATRIX, MATRIX, MATRIX, VECTOR))
def add_wrench(held: HeldNodes, gradient: Array, x: Array, flange: Array, wrench: Array) -> None:
    """Subtract the reactions r_k at the held nodes, and (x_k - o) x r_k, from the wrench at the flange.

    Args:
        held: nodes.
        gradient: (n, 3) [N], of the potential; held components are supplied with it.
        x: (n, 3) [m].
        flange: (4, 3).
        wrench: (6,), force and torque on the flange at its origin o, world axes.
    """
    reaction = np.empty(3)
    for k in range(held.nodes.shape[0]):
        node = held.nodes[k]
        for r in range(3):
            reaction[r] = gradient[node, r] if held.components[k, r] else 0.0
        for r in range(3):
            i, m = (r + 1) % 3, (r + 2) % 3
            arm_i, arm_m = x[node, i] - flange[0, i], x[node, m] - flange[0, m]
            wrench[r] -= reaction[r]
            wrench[3 + r] -= arm_i * reaction[m] - arm_m * reaction[i]
