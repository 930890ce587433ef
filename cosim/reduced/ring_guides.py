"""Guides: springs that hold the frame of every ring near a wanted pose and leave the ring free to deform.
With the measure J of a ring's frame (see `RingFrames.measures`) at the wanted orientation, energy = k_t |J_r
x - c|^2 / 2 + k_r |J_phi x|^2 / 2, quadratic in the nodes. Section models are fitted to the forces of these
springs.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.reduced.section_model import RingFrames
from cosim.soft.elements import element
from cosim.soft.linear.pattern import BlockPattern


@final
@dataclass(frozen=True)
class RingGroup:
    """Rings with the same number of nodes, and the Hessian blocks of their pairs of nodes.

    Args:
        frame: (k,) indices of their frames, less one.
        nodes: (k, m).
        slots: (k, pairs), blocks of the pattern.
        row: (k, pairs), index in the ring of each pair's row.
        column: (k, pairs), index in the ring of each pair's column.
    """

    frame: IntArray
    nodes: IntArray
    slots: IntArray
    row: IntArray
    column: IntArray

    @classmethod
    def all_of(cls, pattern: BlockPattern, frames: RingFrames) -> "tuple[RingGroup, ...]":
        """Return the groups of all rings; the nodes of a ring are coupled in the pattern."""
        groups = []
        sizes = np.array([len(ring) for ring in frames.rings])
        for size in np.unique(sizes[sizes > 0]):
            frame = np.flatnonzero(sizes == size)
            pairs = [_pairs(pattern, frames.rings[f]) for f in frame]
            slots, row, column = (np.array(column_of_table) for column_of_table in zip(*pairs, strict=True))
            groups.append(cls(frame, np.array([frames.rings[f] for f in frame]), slots, row, column))
        return tuple(groups)


def _pairs(pattern: BlockPattern, ring: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return (block, index of the row's node, index of the column's node) of all pairs in a ring."""
    index_in_ring = np.full(pattern.nodes, -1, dtype=np.int64)
    index_in_ring[ring] = np.arange(len(ring))
    slots = np.flatnonzero((index_in_ring[pattern.row] >= 0) & (index_in_ring[pattern.column] >= 0))
    return slots, index_in_ring[pattern.row[slots]], index_in_ring[pattern.column[slots]]


@final
class RingGuides:
    """Guides of all rings to wanted frames, which are its attribute `wanted`.

    Args:
        frames: of the body.
        groups: its rings.
        wanted: (f, 4, 3), the first is the flange.
        stiffness: (6,) [N/m, N m].
    """

    def __init__(
        self, frames: RingFrames, groups: tuple[RingGroup, ...], wanted: Array, stiffness: Array
    ) -> None:
        measures = frames.measures(wanted)
        self.wanted = wanted
        self._groups, self._stiffness = groups, stiffness
        self._measures = [np.array([measures[f] for f in group.frame]) for group in groups]
        self._centers = [wanted[1 + group.frame, 0] for group in groups]
        self._blocks = [
            np.einsum("kpar,kpas->kprs", weighted, measure)
            for weighted, measure in (
                (_chosen(stiffness[:, None, None] * m, group.row), _chosen(m, group.column))
                for m, group in zip(self._measures, groups, strict=True)
            )
        ]

    def add(self, positions: Array, sums: element.Sums, hessian: bool) -> float:
        """Add the gradient and, if `hessian`, the Hessian; return the energy [J]."""
        energy = 0.0
        parts = zip(self._groups, self._measures, self._centers, self._blocks, strict=True)
        for group, measure, center, stiffness in parts:
            deviation = np.einsum("kamr,kmr->ka", measure, positions[group.nodes])
            deviation[:, :3] -= center
            pull = self._stiffness * deviation
            energy += 0.5 * float((pull * deviation).sum())
            sums.gradient[group.nodes] += np.einsum("ka,kamr->kmr", pull, measure)
            if hessian:
                sums.blocks[group.slots] += stiffness
        return energy

    def force(self, positions: Array) -> Array:
        """Return the forces (n, 3) [N] of the springs on the nodes."""
        pull = np.zeros_like(positions)
        self.add(positions, element.Sums(pull), hessian=False)
        return -pull


def _chosen(measure: Array, index_in_ring: IntArray) -> Array:
    """Return the measures (k, pairs, 6, 3) of the nodes with indices (k, pairs) in each ring."""
    return np.asarray(measure.transpose(0, 2, 1, 3)[np.arange(len(index_in_ring))[:, None], index_in_ring])
