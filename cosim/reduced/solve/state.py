"""What the next step of a chain of frames depends on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array


@final
@dataclass(frozen=True)
class ChainState:
    """Points of all frames and their velocities.

    Args:
        motion: (2, f, 4, 3), positions [m] of the origins and unit axes, and the velocities of both.
        earlier: (2, f, 4, 3), the same one step before, for two-step integrators; None for none.
    """

    motion: Annotated[Array, (2, "frames", 4, 3)]
    earlier: Annotated[Array, (2, "frames", 4, 3)] | None = None

    @classmethod
    def at_rest(cls, frames: Array) -> ChainState:
        """Return frames (f, 4, 3) without velocity."""
        return cls(np.array((frames, np.zeros_like(frames))))

    @property
    def frames(self) -> Array:
        """(f, 4, 3) origins [m] and axes."""
        frames: Array = self.motion[0]
        return frames

    @property
    def rates(self) -> Array:
        """(f, 4, 3), velocities of the origins [m/s] and axes [1/s]."""
        rates: Array = self.motion[1]
        return rates
