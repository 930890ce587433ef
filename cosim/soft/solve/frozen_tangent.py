"""The tangent of all nodes of a film at a shape, held ones included, with frozen losses along cables."""

from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.film.film import FilmPotential
from cosim.soft.linear.linear_solver import LowRank


class FrozenTangent(NamedTuple):
    """The tangent of all nodes at a shape, with frozen losses along cables.

    Args:
        row: (blocks,) of its lower half.
        column: (blocks,).
        blocks: (blocks, 3, 3) [N/m].
        low_rank: dense parts; None for none.
        caps: terms of missing caps, by ring.
    """

    row: IntArray
    column: IntArray
    blocks: Array
    low_rank: LowRank | None
    caps: list[tuple[IntArray, Array]]

    @classmethod
    def of(cls, film: FilmPotential, positions: Array, near: Mask | None = None) -> "FrozenTangent":
        """Return the tangent that a film has assembled last.

        Args:
            film: with the assembled tangent.
            positions: (n, 3) [m], of the tangent.
            near: (n,) nodes whose blocks, with those of their neighbours, are copied; None for all.
        """
        tangent, caps = film.tangent, film.open_cap_stiffness(positions)
        pattern = tangent.pattern
        used = slice(None) if near is None else np.flatnonzero(near[pattern.row] | near[pattern.column])
        blocks = tangent.blocks[used].copy()
        return cls(pattern.row[used], pattern.column[used], blocks, tangent.low_rank, caps)

    def times(self, motion: Array) -> Array:
        """Return K v of motions v (n, 3, ...)."""
        row, column = self.row, self.column
        force, below = np.zeros_like(motion), row > column
        np.add.at(force, row, np.einsum("brc,bc...->br...", self.blocks, motion[column]))
        upper_force = np.einsum("bcr,bc...->br...", self.blocks[below], motion[row[below]])
        np.add.at(force, column[below], upper_force)
        if self.low_rank is not None:
            along = np.einsum("knr,nr...->k...", self.low_rank.vectors, motion)
            force += np.einsum("k,k...,knr->nr...", self.low_rank.coefficients, along, self.low_rank.vectors)
        for ring, cap_terms in self.caps:
            ring_motion = motion[ring]
            force[ring] += (cap_terms @ ring_motion.reshape(len(cap_terms), -1)).reshape(ring_motion.shape)
        return force
