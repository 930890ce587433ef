"""Joint angles through a phase."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
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
        """Return position, velocity and acceleration (joints,) [rad, rad/s, rad/s^2].

        On a piece, q = sum_k c_k u^(3 - k) with u from its first knot; SciPy's evaluation, made for many
        points at a time, takes ten times as long for one.
        """
        if self.spline is None:
            return self.first, self._still, self._still
        knots, coefficients = self._pieces
        piece = min(max(bisect_right(knots, progress.value) - 1, 0), len(coefficients) - 1)
        u, rate = progress.value - knots[piece], progress.rate
        squared, turn = rate * rate, progress.acceleration
        q, velocity, acceleration = np.array(
            (
                (u * u * u, u * u, u, 1.0),
                (3.0 * u * u * rate, 2.0 * u * rate, rate, 0.0),
                (6.0 * u * squared + 3.0 * u * u * turn, 2.0 * (squared + u * turn), turn, 0.0),
            )
        ).dot(coefficients[piece])
        return q, velocity, acceleration

    @cached_property
    def _still(self) -> Array:
        return np.zeros_like(self.first)

    @cached_property
    def _pieces(self) -> tuple[list[float], Array]:
        """Knots of the spline, and its coefficients (pieces, 4, joints), highest power first."""
        assert self.spline is not None
        return self.spline.x.tolist(), np.ascontiguousarray(self.spline.c.transpose(1, 0, 2))
