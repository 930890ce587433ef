"""What contacts of the film with the scene carry from one tick to the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray


@final
@dataclass(frozen=True)
class ContactMemory:
    """The contacts that pressed at the end of a tick.

    Args:
        key: (k,) ascending; names the pair of contact point and shape.
        normal_force: (k,) [N].
        offset: (k, 3) [m], shape frame: from where the shape carries the point to the anchor.
        place: (k, 3) [m], world: for features, where they were; for points of the film, not used.
        triangle: (k,) of the film, that held a feature back; -1 for points of the film, and for features
            that it only brushed, no deeper than the law's transition.
    """

    key: Annotated[IntArray, ("k",)]
    normal_force: Annotated[Array, ("k",)]
    offset: Annotated[Array, ("k", 3)]
    place: Annotated[Array, ("k", 3)]
    triangle: Annotated[IntArray, ("k",)]

    @classmethod
    def empty(cls) -> ContactMemory:
        """Return the memory of no contact."""
        return cls(
            np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)
        )
