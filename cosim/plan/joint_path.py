"""Joint angles along a phase, and the joint references at instants of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.cubic_spline import CubicSpline
from cosim.base.frames import Array, IntArray, Mask
from cosim.plan.ramp import Progress

_FEW: Final = 4
"""Number of instants up to which comparing them takes longer than computing them."""


@final
@dataclass(frozen=True)
class JointReference:
    """Reference of an arm's joints, at one instant or at n.

    Args:
        position: (joints,) or (n, joints) [rad].
        velocity: (joints,) or (n, joints) [rad/s].
        acceleration: (joints,) or (n, joints) [rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array

    def row(self, k: int) -> JointReference:
        """Return the reference at one of several instants."""
        return JointReference(self.position[k], self.velocity[k], self.acceleration[k])

    def as_rows(self) -> JointReference:
        """Return the reference at one instant as that of n = 1 instants."""
        return JointReference(self.position[None], self.velocity[None], self.acceleration[None])

    def some(self, k: int, end: int | None) -> JointReference:
        """Return the reference at instants k to end of several."""
        return JointReference(self.position[k:end], self.velocity[k:end], self.acceleration[k:end])

    def distinct(self) -> tuple[Mask | slice, IntArray | slice]:
        """Return the instants that differ from the one before, and the index among them of every instant."""
        if len(self.position) <= _FEW:
            return slice(None), slice(None)
        parts = self.position, self.velocity, self.acceleration
        changes = np.logical_or.reduce([part[1:] != part[:-1] for part in parts])
        new = np.concatenate([[True], changes.any(axis=1)])
        return new, np.cumsum(new) - 1


@final
@dataclass(frozen=True)
class JointPath:
    """Joint angles over the progress s of a phase.

    Args:
        first: (joints,) [rad], at s = 0.
        spline: cubic over s, or None if the arm does not move.
    """

    first: Array
    spline: CubicSpline | None

    @property
    def last(self) -> Array:
        """(joints,) [rad], at s = 1."""
        return self.first if self.spline is None else np.asarray(self.spline(1.0))

    def at(self, progress: Progress) -> JointReference:
        """Return the reference at one instant."""
        return self.through([progress]).row(0)

    def through(self, instants: Sequence[Progress]) -> JointReference:
        """Return the references at n instants; one call is much faster than n calls of `at`."""
        if self.spline is None:
            still = np.zeros((len(instants), len(self.first)))
            return JointReference(still + self.first, still, still)
        s, rate, acceleration = np.array([(p.value, p.rate, p.acceleration) for p in instants]).T[..., None]
        q, slope, curve = (np.asarray(self.spline(s[:, 0], order)) for order in range(3))
        return JointReference(q, slope * rate, curve * rate**2 + slope * acceleration)
