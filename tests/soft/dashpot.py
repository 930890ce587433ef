"""Linear dashpots between nodes of a soft robot: elements with a memory of the last step.

energy = c (l - l_n)^2 / (2 h), gradient = c (l - l_n) / h by the unit vector, with l_n the length at the
step's beginning and h the step: the force is c times the mean rate of the length. Statics does not feel them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.config.schema.soft_robot import ElementTable
from cosim.config.toml.quantities import Positive
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.element import NODES, ROWS, STILL, DirectElement, Instant


@final
@dataclass(frozen=True)
class Dashpots(DirectElement):
    """Dashpots between pairs of nodes; they remember their lengths [m].

    Args:
        nodes: (d, 2) node indices.
        damping_Ns_m: (d,), c.
    """

    label: ClassVar[str] = "dashpots"
    far: ClassVar[bool] = True

    nodes: Annotated[IntArray, NODES]
    damping_Ns_m: Annotated[Array, ROWS]

    def first_memory(self, positions: Array) -> Array:
        return np.linalg.norm(positions[self.nodes[:, 1]] - positions[self.nodes[:, 0]], axis=1)

    def advanced(self, positions: Array, tracked: Array) -> Array:
        return self.first_memory(positions)

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        if math.isinf(at.step_s):
            return 0.0
        way = positions[self.nodes[:, 1]] - positions[self.nodes[:, 0]]
        length = np.linalg.norm(way, axis=1)
        unit, stiffness = way / length[:, None], self.damping_Ns_m / at.step_s
        force = stiffness * (length - at.memory)
        np.add.at(gradient, self.nodes[:, 1], force[:, None] * unit)
        np.add.at(gradient, self.nodes[:, 0], -force[:, None] * unit)
        if len(slots):
            along = np.einsum("dr,ds->drs", unit, unit)
            across = (force / length)[:, None, None] * (np.eye(3) - along)
            block = stiffness[:, None, None] * along + across  # symmetric: a transposed place is the same
            for pair, sign in enumerate((1.0, -1.0, 1.0)):
                place = np.where(slots[:, pair] < 0, -1 - slots[:, pair], slots[:, pair])
                np.add.at(blocks, place, sign * block)
        return float(0.5 * force @ (length - at.memory))


@final
@dataclass(frozen=True, kw_only=True)
class DashpotTable(ElementTable):
    """A dashpot between two nodes.

    Args:
        ends: ring of each end and place in that ring, from 0 on.
        damping_Ns_m: force over the rate of the length.
    """

    kind: Literal["dashpot"] = "dashpot"
    ends: tuple[tuple[str, int], tuple[str, int]]
    damping_Ns_m: Positive

    def element(self, body: SoftBody) -> Dashpots:
        for ring, place in self.ends:
            if not 0 <= place < len(body.rings.get(ring, ())):
                raise InputError(f"ring '{ring}' has no node {place}, where a dashpot ends")
        nodes = np.array([[body.rings[ring][place] for ring, place in self.ends]])
        return Dashpots(nodes, np.array([self.damping_Ns_m]))
