"""A shaking motion of the flange through a phase."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.config.schema.phase import PhaseTable
from cosim.plan.ramp import progress

_PIECES_PER_CYCLE = 24


@final
@dataclass(frozen=True)
class Shake:
    """u(s) = amplitude w(s) sin(2 pi cycles s); w rises smoothly in the first cycle and falls in the last.

    Args:
        amplitude: (3,) [m], world.
        cycles: in the whole phase.
    """

    amplitude: Array
    cycles: float

    @classmethod
    def of(cls, phase: PhaseTable) -> Shake | None:
        """Return that of a phase, None where it does not shake."""
        given = phase.flange_shake
        if given is None:
            return None
        axis = np.array(given.axis)
        return cls(given.amplitude_m / np.linalg.norm(axis) * axis, given.frequency_Hz * phase.duration_s)

    def at(self, fraction: float) -> Array:
        """Return the displacement (3,) [m] at a fraction of the phase."""
        from_end = self.cycles * min(fraction, 1.0 - fraction)
        fade = progress("smooth", from_end, 1.0).value
        return np.asarray(fade * math.sin(2.0 * math.pi * self.cycles * fraction) * self.amplitude)

    @property
    def pieces(self) -> int:
        """Into how many small motions it is cut."""
        return math.ceil(_PIECES_PER_CYCLE * self.cycles)
