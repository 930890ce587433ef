"""Joint angles through a phase."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.frames import Array
from cosim.scenario.ramp import Progress


@final
@dataclass(frozen=True)
class JointPath:
    """Joint angles over the progress s of a phase.

    Args:
        first: (joints,) [rad], at s = 0.
        spline: cubic over s, or None where the arm stands still.
    """

    first: Array
    spline: CubicSpline | None

    @property
    def last(self) -> Array:
        """(joints,) [rad], at s = 1."""
        return self.first if self.spline is None else np.asarray(self.spline(1.0))

    def at(self, progress: Progress) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration (joints,) [rad, rad/s, rad/s^2]."""
        if self.spline is None:
            still = np.zeros_like(self.first)
            return self.first, still, still
        q, slope, curve = (np.asarray(self.spline(progress.value, order)) for order in range(3))
        return q, slope * progress.rate, curve * progress.rate**2 + slope * progress.acceleration
