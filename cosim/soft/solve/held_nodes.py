"""Nodes that the flange holds, in kernels: where it has them, and what they put on it.

The flange is a (4, 3) array: its origin [m], then its three axes, world.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.kernels import (
    BOOLEAN,
    INDICES,
    MASKS,
    MATRIX,
    VECTOR,
    device_function,
    kernel,
    small_vector,
    zero_vector,
)

_JUMP_m: Final = 2e-5
"""Of held nodes, from where free flight would have them; below it, flight is as good a start."""


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


@device_function
def _place(held, flange, k, r):  # type: ignore[no-untyped-def]
    """Return component r of where the flange has held node k."""
    place = held.offsets[k, 0] * flange[1, r] + held.offsets[k, 1] * flange[2, r]
    return place + held.offsets[k, 2] * flange[3, r] + flange[0, r]


@device_function
def _place_all(held, flange, x):  # type: ignore[no-untyped-def]
    for k in range(held.nodes.shape[0]):
        for r in range(3):
            if held.components[k, r]:
                x[held.nodes[k], r] = _place(held, flange, k, r)


@kernel(types.void(HELD, MATRIX, MATRIX))
def place_held(held: HeldNodes, flange: Array, x: Array) -> None:
    """Put the held components of x (n, 3) [m] where the flange has them."""
    _place_all(held, flange, x)


@kernel(BOOLEAN(HELD, MATRIX, MATRIX))
def place_flight(held: HeldNodes, flange: Array, x: Array) -> bool:
    """Put the held components where the flange has them; where that is a jump, all nodes go along.

    Free flight does not know what a flange is commanded anew. Held nodes alone would stretch the film beside
    them, with a force beyond all else that acts; where all are moved, they meet their inertia only.

    Args:
        held: nodes.
        flange: (4, 3).
        x: (n, 3) [m], in free flight; changed.

    Returns:
        Whether the nodes went along: by the mean jump of those of which all components are held.
    """
    jump, count, most = zero_vector(3), 0, 0.0
    for k in range(held.nodes.shape[0]):
        if held.components[k, 0] and held.components[k, 1] and held.components[k, 2]:
            count += 1
            for r in range(3):
                jump[r] += _place(held, flange, k, r) - x[held.nodes[k], r]
    for r in range(3):
        most = max(most, abs(jump[r]))
    jumps = most > _JUMP_m * count
    if jumps:
        for i in range(x.shape[0]):
            for r in range(3):
                x[i, r] += jump[r] / count
    _place_all(held, flange, x)
    return jumps


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
    reaction = small_vector(3)
    for k in range(held.nodes.shape[0]):
        node = held.nodes[k]
        for r in range(3):
            reaction[r] = gradient[node, r] if held.components[k, r] else 0.0
        for r in range(3):
            i, m = (r + 1) % 3, (r + 2) % 3
            arm_i, arm_m = x[node, i] - flange[0, i], x[node, m] - flange[0, m]
            wrench[r] -= reaction[r]
            wrench[3 + r] -= arm_i * reaction[m] - arm_m * reaction[i]
