"""Swing of a soft arm that its flange accelerates, as one undamped oscillator: y'' = w^2 (a - y)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.frames import Array
from cosim.plan import ramp
from cosim.plan.plan import PhasePlan

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm

_SAMPLES = 41  # of a phase, at least
_TAIL_MAX = 2000  # samples after it


@final
@dataclass(frozen=True)
class FlangeAcceleration:
    """Accelerations of the flange's origin in a phase.

    Args:
        fractions: (k,) progress of the phase.
        values: (k, 3) [m/s^2], world.
        step_s: between them.
    """

    fractions: Array
    values: Array
    step_s: float

    @classmethod
    def of(cls, arm: Arm, planned: PhasePlan) -> FlangeAcceleration | None:
        """Return the accelerations of a phase; None if the flange does not move, or jumps."""
        phase, path = planned.phase, planned.joints
        if path.spline is None or phase.ramp == "step":
            return None
        count = max(_SAMPLES, 2 * len(path.spline.x))
        step_s = phase.duration_s / (count - 1)
        # one more sample at each end: a linear ramp jumps from rest to its speed
        ways = [ramp.progress(phase.ramp, k * step_s, phase.duration_s) for k in range(-1, count + 1)]
        x = np.array([arm.forward(path.at(way).position).translation for way in ways])
        fractions = np.array([way.value for way in ways[1:-1]])
        return cls(fractions, np.diff(x, n=2, axis=0) / step_s**2, step_s)

    @property
    def largest(self) -> Array:
        """(3,) [m/s^2], the acceleration of largest size."""
        return np.asarray(self.values[int(np.argmax(np.linalg.norm(self.values, axis=1)))])

    def swing(self, rate_rad_s: float) -> tuple[float, Array]:
        """Return when an undamped oscillator is farthest, and the equivalent static acceleration.

        y'' = w^2 (a - y), exact for an acceleration a that is constant between samples. Slow motions give
        y = a, a sudden and lasting acceleration up to y = 2 a, a short one less than a.

        Args:
            rate_rad_s: w.

        Returns:
            Progress of the phase; acceleration y (3,) [m/s^2] of its foot.
        """
        tail = min(_TAIL_MAX, math.ceil(2.0 * math.pi / (rate_rad_s * self.step_s)))
        angle = rate_rad_s * self.step_s
        cosine, sine = math.cos(angle), math.sin(angle)
        y, rate = np.zeros(3), np.zeros(3)  # rate: y' / w
        farthest, place = y, 0
        for k, a in enumerate([*self.values, *np.zeros((tail, 3))]):
            y, rate = a + cosine * (y - a) + sine * rate, cosine * rate - sine * (y - a)
            if y @ y > farthest @ farthest:
                farthest, place = y, k
        return float(self.fractions[min(place, len(self.fractions) - 1)]), farthest
