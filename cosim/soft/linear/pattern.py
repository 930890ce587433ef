"""The fixed sparsity pattern of the tangent stiffness, as 3 x 3 blocks of node pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray


@final
@dataclass(frozen=True)
class BlockPattern:
    """Lower triangle of a symmetric matrix of 3 x 3 node blocks.

    Block s couples node row[s] with node column[s], row[s] >= column[s].

    Args:
        nodes: number of nodes.
        row: (blocks,) node of the block's rows.
        column: (blocks,) node of the block's columns.
    """

    nodes: int
    row: Annotated[IntArray, ("k",)]
    column: Annotated[IntArray, ("k",)]

    @classmethod
    def from_elements(cls, nodes: int, elements: Sequence[IntArray]) -> BlockPattern:
        """Return the union of all node pairs within each element and of all diagonal blocks.

        Args:
            nodes: number of nodes.
            elements: arrays (elements, nodes per element) of node indices.
        """
        keys = [np.arange(nodes, dtype=np.int64) * (nodes + 1)]
        for element in elements:
            for a in range(element.shape[1]):
                for b in range(a):
                    high = np.maximum(element[:, a], element[:, b])
                    keys.append(high * nodes + np.minimum(element[:, a], element[:, b]))
        key = np.unique(np.concatenate(keys))
        return cls(nodes, key // nodes, key % nodes)

    @property
    def blocks(self) -> int:
        """Number of stored blocks."""
        return len(self.row)

    def slots(self, elements: IntArray) -> IntArray:
        """Return where each element's node pairs are stored.

        Pair (a, b), a >= b, of an element is column a (a + 1) / 2 + b. The value s >= 0 means block s;
        s < 0 means block -1 - s, to be added transposed because node a precedes node b.

        Args:
            elements: (elements, k) node indices.
        """
        count, k = elements.shape
        result = np.empty((count, k * (k + 1) // 2), dtype=np.int64)
        stored = self.row * self.nodes + self.column
        for a in range(k):
            for b in range(a + 1):
                na, nb = elements[:, a], elements[:, b]
                key = np.maximum(na, nb) * self.nodes + np.minimum(na, nb)
                slot = np.searchsorted(stored, key)
                result[:, a * (a + 1) // 2 + b] = np.where(na >= nb, slot, -1 - slot)
        return result


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


@final
class PatternWidening:
    """Widens a body's own pattern by elements; what was found last is kept while it serves.

    Args:
        body: its own pattern.
    """

    def __init__(self, body: BlockPattern) -> None:
        self._body = body
        self._last: tuple[IntArray, CoupledPattern, IntArray] | None = None

    def places(self, elements: IntArray) -> tuple[CoupledPattern, IntArray]:
        """Return the wider pattern for elements (k, nodes per element), and where their node pairs are."""
        last = self._last
        if last is None or not np.array_equal(last[0], elements):
            coupled = CoupledPattern.of(self._body, elements)
            if last is not None and last[1].same_as(coupled):
                coupled = last[1]
            self._last = last = (elements, coupled, coupled.pattern.slots(elements))
        return last[1:]
