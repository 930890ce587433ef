"""Sums of 3 x 3 blocks, of which the upper half is kept."""

from __future__ import annotations

from typing import Any

from cosim.base.kernels import device_function


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
