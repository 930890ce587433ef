"""A sparsity pattern that also holds the node pairs of contacts between films.

Where neighbours touch, a factorisation in the wider pattern costs little more than one in the body's own; a
dense term of low rank per contact costs six times as much for fifty contacts, and blocks that are dropped and
made up for on the diagonal do not converge (`benchmarks/self_contact.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.linear.pattern import BlockPattern


@final
@dataclass(frozen=True)
class CoupledPattern:
    """A body's pattern, widened.

    Args:
        pattern: holds all pairs of the body's own and those of the contacts.
        from_body: (blocks of the body's own,) where they are in it.
    """

    pattern: BlockPattern
    from_body: IntArray

    @classmethod
    def of(cls, body: BlockPattern, elements: IntArray) -> CoupledPattern:
        """Return that of a body's own pattern and further elements (k, nodes per element)."""
        own = np.column_stack([body.row, body.column])
        wide = BlockPattern.from_elements(body.nodes, [own, elements])
        place = np.searchsorted(wide.row * wide.nodes + wide.column, body.row * body.nodes + body.column)
        return cls(wide, place)

    def same_as(self, other: CoupledPattern) -> bool:
        """Whether both hold the same node pairs."""
        mine, theirs = self.pattern, other.pattern
        return np.array_equal(mine.row, theirs.row) and np.array_equal(mine.column, theirs.column)

    def blocks(self, body_blocks: Array) -> Array:
        """Return the body's blocks in the wider pattern, zero elsewhere: (pattern.blocks, 3, 3)."""
        wide = np.zeros((self.pattern.blocks, 3, 3))
        wide[self.from_body] = body_blocks
        return wide
