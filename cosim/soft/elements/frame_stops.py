"""Frames of a stack that rest on one another: facing nodes of neighbouring rims keep a distance.

Nodes a and b face each other on the rims of two neighbouring units, d apart. Frames of height h with two
films of thickness t between them meet where d falls to g: h + 2 t along the stack, and r to the side where
the drawn units taper, so
    g^2 = (h + 2 t)^2 + r^2,   energy = k F(g - d),   gradient by b = -k f(g - d) (x_b - x_a) / d,
with F and f the onset of a cable's tension (`cable`): no force beyond g, a spring of k below it. Forces are
equal, opposite and on one line. Frames slide over one another without friction, on a sphere of radius g.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Matrix
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.soft.elements.cable import onset as onset_of_tension
from cosim.soft.elements.element import NODES, ROWS, Call, LeafElement, Remembered, writable
from cosim.soft.linear.pattern import add_block

STIFFNESS_N_m: Final = 1e5
"""K, of two frames on each other: 10 N press them by 0.1 mm into one another."""

onset = device_function(onset_of_tension)


@kernel
def add_stops(
    x: Matrix, pairs: IndexTable, springs: Matrix, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add all pairs to gradient and, if slots is not empty, their Hessian to blocks.

    Returns the energy [J].
    """
    u, block, minus, energy = small_vector(3), small_matrix(3, 3), small_matrix(3, 3), 0.0
    for e in range(pairs.shape[0]):
        a, b, k, square = pairs[e, 0], pairs[e, 1], springs[e, 1], 0.0
        for r in range(3):
            u[r] = x[b, r] - x[a, r]
            square += u[r] * u[r]
        d = math.sqrt(square)
        level, force, slope = onset(springs[e, 0] - d)
        if force == 0.0:
            continue
        energy += k * level
        for r in range(3):
            u[r] /= d
            gradient[a, r] += k * force * u[r]
            gradient[b, r] -= k * force * u[r]
        if slots.shape[0] > 0:
            across = -k * force / d
            for r in range(3):
                for c in range(3):
                    block[r, c] = (k * slope - across) * u[r] * u[c]
                block[r, r] += across
            for r in range(3):
                for c in range(3):
                    minus[r, c] = -block[r, c]
            add_block(blocks, slots[e, 0], block)
            add_block(blocks, slots[e, 1], minus)
            add_block(blocks, slots[e, 2], block)
    return energy


@final
@dataclass(frozen=True)
class FrameStops(LeafElement):
    """Frames of one stack that rest on one another.

    Args:
        pairs: (p, 2) facing nodes of neighbouring rims.
        springs: (p, 2), g [m] and k [N/m].
    """

    label: ClassVar[str] = "stops of frames"
    far: ClassVar[bool] = True

    pairs: Annotated[IntArray, NODES]
    springs: Annotated[Array, ROWS]

    @classmethod
    def from_shape(cls, positions: Array, rings: IntArray, rest_m: float) -> "FrameStops":
        """Return the stops of a straight stack drawn along z.

        Args:
            positions: (n, 3) [m], drawn shape.
            rings: (f, m) nodes of the rims, base to tip, which face one another in their order.
            rest_m: h + 2 t, between rims at rest on one another.
        """
        pairs = np.stack([rings[:-1].ravel(), rings[1:].ravel()], axis=1)
        aside = (positions[pairs[:, 1]] - positions[pairs[:, 0]])[:, :2]
        gaps = np.sqrt(rest_m**2 + (aside**2).sum(axis=1))
        springs = np.stack([gaps, np.full(len(gaps), STIFFNESS_N_m / rings.shape[1])], axis=1)
        return cls(pairs, springs)

    def length(self, positions: Array) -> float:
        """Return the length [m] of a stack from its first frame to its last, both included.

        Args:
            positions: (n, 3) [m].
        """
        first = self.pairs[~np.isin(self.pairs[:, 0], self.pairs[:, 1]), 0]
        rims = np.vstack((first, self.pairs[:, 1].reshape(-1, len(first))))
        steps = np.diff(positions[rims].mean(axis=1), axis=0)
        return float(self.springs[0, 0] + np.linalg.norm(steps, axis=1).sum())

    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call:
        return Call(add_stops, (writable(self.pairs), writable(self.springs), slots, gradient, blocks))
