"""Which frames of a chain the flange holds, and where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.errors import InputError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.solve.kinematics import carried


@final
@dataclass(frozen=True)
class FrameClamp:
    """Frames held rigidly to the flange.

    Args:
        held: (f,) which.
        offsets: (f, 4, 3), held frames in the flange frame; of others without meaning.
    """

    held: Mask
    offsets: Array

    @classmethod
    def of_base(cls, section: SectionBody) -> FrameClamp:
        """Return the clamp that holds the flange's own frame."""
        drawn = section.frames.drawn
        return cls(np.arange(len(drawn)) == 0, drawn)

    @cached_property
    def free(self) -> Mask:
        """(f,) frames that can move."""
        return ~self.held

    def place(self, frames: Array, flange: Pose) -> Array:
        """Return the frames (f, 4, 3) with the held ones where the flange has them."""
        placed = frames.copy()
        placed[self.held] = carried(self.offsets[self.held], flange)
        return placed

    def holding(self, section: SectionBody, nodes: Mask, frames: Array, flange: Pose) -> FrameClamp:
        """Return a clamp that also holds the rings of some nodes where they are now.

        Args:
            section: whose rings they are.
            nodes: (n, 3) components to hold: whole rings.
            frames: (f, 4, 3), where they are.
            flange: its pose.

        Raises:
            InputError: less than a whole ring, or nodes between rings, are to be held.
        """
        held, covered = self.held.copy(), np.zeros_like(nodes)
        covered[section.body.base] = True
        for f, ring in enumerate(section.frames.rings, start=1):
            if nodes[ring].all():
                held[f], covered[ring] = True, True
        if (nodes & ~covered).any():
            raise InputError("section models hold whole outer rings or the tip ring; use fidelity = 'lumped'")
        offsets, new = self.offsets.copy(), held & ~self.held
        offsets[new] = carried(frames[new], flange.inverse())
        return FrameClamp(held, offsets)

    def without(self, section: SectionBody, nodes: IntArray) -> FrameClamp:
        """Return a clamp that lets the rings of the given nodes (m,) go.

        Raises:
            InputError: the base is to be let go.
        """
        if np.isin(section.body.base, nodes).any():
            raise InputError("section models cannot let go of their base; use fidelity = 'lumped'")
        held = self.held.copy()
        for f, ring in enumerate(section.frames.rings, start=1):
            held[f] &= not np.isin(ring, nodes).any()
        return FrameClamp(held, self.offsets)
