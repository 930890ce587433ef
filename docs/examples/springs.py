"""Linear springs between nodes of a soft robot, as one compiled function: energy = k (l - l_0)^2 / 2."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Matrix
from cosim.base.kernels import kernel, small_matrix, small_vector
from cosim.config.schema.soft_robot import ElementTable
from cosim.config.toml.quantities import Positive
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.element import NODES, ROWS, Call, LeafElement, Remembered, writable
from cosim.soft.linear.pattern import add_block


@kernel
def add_springs(
    x: Matrix, nodes: IndexTable, springs: Matrix, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add springs (s, 2) of l_0 [m] and k [N/m] to gradient and, if slots is not empty, to blocks."""
    energy, unit = 0.0, small_vector(3)
    own, other = small_matrix(3, 3), small_matrix(3, 3)
    for e in range(nodes.shape[0]):
        a, b, k, square = nodes[e, 0], nodes[e, 1], springs[e, 1], 0.0
        for r in range(3):
            unit[r] = x[b, r] - x[a, r]
            square += unit[r] * unit[r]
        length = math.sqrt(square)
        force = k * (length - springs[e, 0])
        energy += 0.5 * force * (length - springs[e, 0])
        for r in range(3):
            unit[r] /= length
            gradient[a, r] -= force * unit[r]
            gradient[b, r] += force * unit[r]
        if slots.shape[0] > 0:
            for r in range(3):
                for c in range(3):
                    own[r, c] = (k - force / length) * unit[r] * unit[c] + (force / length if r == c else 0.0)
                    other[r, c] = -own[r, c]
            add_block(blocks, slots[e, 0], own)
            add_block(blocks, slots[e, 1], other)
            add_block(blocks, slots[e, 2], own)
    return energy


@final
@dataclass(frozen=True)
class Springs(LeafElement):
    """Springs between pairs of nodes.

    Args:
        nodes: (s, 2) node indices.
        springs: (s, 2), l_0 [m] and k [N/m].
    """

    label: ClassVar[str] = "springs"
    far: ClassVar[bool] = True

    nodes: Annotated[IntArray, NODES]
    springs: Annotated[Array, ROWS]

    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call:
        return Call(add_springs, (writable(self.nodes), writable(self.springs), slots, gradient, blocks))


@final
@dataclass(frozen=True, kw_only=True)
class SpringTable(ElementTable):
    """A spring between the first nodes of two rings.

    Args:
        rings: their names.
        stiffness_N_m: k.
        length_m: l_0.
    """

    kind: Literal["spring"] = "spring"
    rings: tuple[str, str]
    stiffness_N_m: Positive
    length_m: Positive

    def element(self, body: SoftBody) -> Springs:
        nodes = np.array([[body.rings[ring][0] for ring in self.rings]])
        return Springs(nodes, np.array([[self.length_m, self.stiffness_N_m]]))
