"""Ranges of nodes that no block of a pattern couples: bodies side by side, such as a gripper's fingers."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import IntArray
from cosim.soft.linear.pattern import BlockPattern


def ranges_apart(pattern: BlockPattern) -> IntArray:
    """Return where ranges of nodes begin that nothing couples, and the number of nodes (k + 1,).

    Nodes that are coupled with none belong to a neighbouring range; bodies whose nodes are numbered in turn
    count as one.
    """
    spans = np.zeros(pattern.nodes + 1, np.int64)
    np.add.at(spans, pattern.column + 1, 1)
    np.add.at(spans, pattern.row + 1, -1)
    starts = np.flatnonzero(np.cumsum(spans[:-1]) == 0)  # no pair of nodes has one on either side
    several = np.diff(np.append(starts, pattern.nodes)) > 1
    return np.array([0, *starts[several][1:], pattern.nodes], np.int64)


def part_of(pattern: BlockPattern, begin: int, end: int) -> tuple[BlockPattern, int]:
    """Return the pattern of a range of nodes, numbered from 0, and where its blocks begin in the whole."""
    first, last = np.searchsorted(pattern.row, [begin, end])
    row, column = pattern.row[first:last] - begin, pattern.column[first:last] - begin
    return BlockPattern(end - begin, row, column), int(first)
