"""Sparsity pattern of the tangent stiffness, as 3 x 3 blocks of node pairs, and its widening by contact."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices
from cosim.base.kernels import device_function, kernel
from cosim.base.state_checks import check_indices
from cosim.errors import InputError

SPARE: Final = 1.1  # blocks of a wider pattern over those needed, up to which it is reused


class PatternRows(NamedTuple):
    """A pattern row by row.

    Args:
        first: (nodes + 1,), start of each row's blocks.
        column: (blocks,), ascending in each row.
    """

    first: Indices
    column: Indices


@device_function
def find_block(rows: PatternRows, one: int, two: int) -> int:
    """Return the index of the block that couples two nodes; the number of blocks for uncoupled nodes."""
    row, column = max(one, two), min(one, two)
    low, high, end = rows.first[row], rows.first[row + 1], rows.first[row + 1]
    while low < high:
        middle = (low + high) // 2
        if rows.column[middle] < column:
            low = middle + 1
        else:
            high = middle
    return low if low < end and rows.column[low] == column else rows.column.shape[0]


@kernel
def _find_slots(rows: PatternRows, elements: IndexTable, slots: IndexTable) -> int:
    """Fill the slots of each element's node pairs; return the number of missing ones."""
    missing = 0
    for e in range(elements.shape[0]):
        pair = 0
        for a in range(elements.shape[1]):
            for b in range(a + 1):
                block = find_block(rows, elements[e, a], elements[e, b])
                missing += block == rows.column.shape[0]
                slots[e, pair] = block if elements[e, a] >= elements[e, b] else -1 - block
                pair += 1
    return missing


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
    def from_elements(cls, nodes: int, elements: Sequence[IntArray]) -> "BlockPattern":
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
        key = np.sort(np.concatenate(keys), kind="stable")  # nearly sorted
        key = key[np.append(True, np.diff(key) > 0)]
        return cls(nodes, key // nodes, key % nodes)

    @property
    def blocks(self) -> int:
        """Number of stored blocks."""
        return len(self.row)

    def slots(self, elements: IntArray) -> IntArray:
        """Return the slots of each element's node pairs.

        Pair (a, b), a >= b, of an element is column a (a + 1) / 2 + b. The value s >= 0 means block s;
        s < 0 means block -1 - s, to be added transposed because node a precedes node b.

        Args:
            elements: (elements, k) node indices.
        """
        return self.find(elements)[0]

    def find(self, elements: IntArray) -> tuple[IntArray, int]:
        """Return the slots as `slots` does, and the number of missing pairs, whose slots are not valid."""
        count, k = elements.shape
        slots = np.empty((count, k * (k + 1) // 2), dtype=np.int64)
        elements = np.ascontiguousarray(elements, dtype=np.int64)
        return slots, _find_slots(self.rows, elements, slots)

    @cached_property
    def rows(self) -> PatternRows:
        """The pattern row by row, for kernels."""
        first = np.searchsorted(self.row, np.arange(self.nodes + 1))
        # copied if it is read-only, as in a saved state
        return PatternRows(first, np.require(self.column, requirements="W"))

    @cached_property
    def _key(self) -> IntArray:
        return self.row * self.nodes + self.column


def check_widened(own: BlockPattern, wide: BlockPattern) -> None:
    """Check that a saved pattern contains that of a body.

    Raises:
        InputError: it lacks some of the body's blocks, is not in order, or is of other nodes.
    """
    check_indices(wide.row, own.nodes, "nodes")
    check_indices(wide.column, own.nodes, "nodes")
    key = wide.row * own.nodes + wide.column
    holds = np.isin(own.row * own.nodes + own.column, key).all()
    ordered = (np.diff(key) > 0).all() and (wide.column <= wide.row).all()
    if not (wide.nodes == own.nodes and holds and ordered):
        raise InputError("the saved pattern of touching films is not one of this body")


@final
@dataclass(frozen=True)
class CoupledPattern:
    """A body's pattern, widened by contacts.

    Args:
        pattern: with all pairs of the body and of the contacts.
        from_body: (blocks of the body's pattern,), their indices in `pattern`.
    """

    pattern: BlockPattern
    from_body: IntArray

    @classmethod
    def of(cls, body: BlockPattern, elements: IntArray) -> "CoupledPattern":
        """Return the pattern of a body with further elements (k, nodes per element)."""
        body_pairs = np.column_stack([body.row, body.column])
        return cls.around(body, BlockPattern.from_elements(body.nodes, [body_pairs, elements]))

    @classmethod
    def around(cls, body: BlockPattern, wide: BlockPattern) -> "CoupledPattern":
        """Return a wider pattern that contains a body's."""
        return cls(wide, np.searchsorted(wide._key, body._key))

    def wasteful(self, slots: IntArray) -> bool:
        """Return whether many blocks belong neither to the body nor to elements with these slots."""
        used = np.zeros(self.pattern.blocks, dtype=bool)
        used[self.from_body] = used[np.where(slots < 0, -1 - slots, slots)] = True
        return self.pattern.blocks > SPARE * int(np.count_nonzero(used))

    def blocks(self, body_blocks: Array) -> Array:
        """Return the body's blocks in the wider pattern, zero elsewhere: (pattern.blocks, 3, 3)."""
        wide = np.zeros((self.pattern.blocks, 3, 3))
        wide[self.from_body] = body_blocks
        return wide


@final
class PatternWidening:
    """Widens a body's pattern by elements; a pattern that still fits is reused.

    Args:
        body: pattern of the body.
    """

    def __init__(self, body: BlockPattern) -> None:
        self._body = body
        self._last = CoupledPattern.around(body, body)

    def around(self, elements: IntArray, last: BlockPattern) -> CoupledPattern:
        """Return a wider pattern for elements (k, nodes per element).

        Args:
            elements: in contact.
            last: pattern of the last factorised tangent: reused if it contains all pairs, otherwise widened,
                unless most of its extra blocks are not needed any more.
        """
        coupled = self.known(last)
        slots, missing = last.find(elements)
        if missing or coupled.wasteful(slots):
            coupled = CoupledPattern.around(self._body, CoupledPattern.of(last, elements).pattern)
            slots = coupled.pattern.slots(elements)
            if coupled.wasteful(slots):
                coupled = CoupledPattern.of(self._body, elements)
                slots = coupled.pattern.slots(elements)
        self._last = coupled
        return coupled

    def known(self, last: BlockPattern) -> CoupledPattern:
        """Return a wider pattern as a `CoupledPattern`; the last one is cached."""
        if self._last.pattern is not last:
            self._last = CoupledPattern.around(self._body, last)
        return self._last


def uncoupled_ranges(pattern: BlockPattern) -> IntArray:
    """Return the first nodes of ranges that no block couples, and the number of nodes (k + 1,).

    Such ranges are bodies side by side, as a gripper's fingers. Nodes without coupling belong to a
    neighbouring range; bodies with alternating node numbers count as one.
    """
    spans = np.zeros(pattern.nodes + 1, np.int64)
    np.add.at(spans, pattern.column + 1, 1)
    np.add.at(spans, pattern.row + 1, -1)
    starts = np.flatnonzero(np.cumsum(spans[:-1]) == 0)  # no pair of nodes has one on either side
    several = np.diff(np.append(starts, pattern.nodes)) > 1
    return np.array([0, *starts[several][1:], pattern.nodes], np.int64)


def part_of(pattern: BlockPattern, begin: int, end: int) -> tuple[BlockPattern, int]:
    """Return the pattern of a range of nodes, numbered from 0, and the index of its first block."""
    first, last = np.searchsorted(pattern.row, [begin, end])
    row, column = pattern.row[first:last] - begin, pattern.column[first:last] - begin
    return BlockPattern(end - begin, row, column), int(first)


@device_function
def add_block(blocks: Any, slot: int, value: Any) -> None:
    """Add a 3 x 3 value to block `slot`, or its transpose to block -1 - slot."""
    if slot >= 0:
        for r in range(3):
            for c in range(3):
                blocks[slot, r, c] += value[r, c]
    else:
        slot = -1 - slot
        for r in range(3):
            for c in range(3):
                blocks[slot, r, c] += value[c, r]
