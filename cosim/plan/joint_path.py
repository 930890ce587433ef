"""Joint angles through a phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.interpolate import CubicSpline

from cosim.base.frames import Array, IntArray, Mask
from cosim.plan.ramp import Progress

_FEW: Final = 4
"""Instants that are worked out faster than compared."""


@final
@dataclass(frozen=True)
class JointReference:
    """What is asked of an arm's joints, at one instant or at n.

    Args:
        position: (joints,) or (n, joints) [rad].
        velocity: the same [rad/s].
        acceleration: the same [rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array

    def row(self, k: int) -> JointReference:
        """Return what is asked at one of several instants."""
        return JointReference(self.position[k], self.velocity[k], self.acceleration[k])

    def as_rows(self) -> JointReference:
        """Return what is asked at one instant as that of one row."""
        return JointReference(self.position[None], self.velocity[None], self.acceleration[None])

    def some(self, k: int, end: int | None) -> JointReference:
        """Return what is asked at some of several instants, from one on."""
        return JointReference(self.position[k:end], self.velocity[k:end], self.acceleration[k:end])

    def distinct(self) -> tuple[Mask | slice, IntArray | slice]:
        """Return the instants to work out, and which of those each is: one for all while the arm stands."""
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
        spline: cubic over s, or None where the arm stands still.
    """

    first: Array
    spline: CubicSpline | None

    @property
    def last(self) -> Array:
        """(joints,) [rad], at s = 1."""
        return self.first if self.spline is None else np.asarray(self.spline(1.0))

    def at(self, progress: Progress) -> JointReference:
        """Return what is asked for at one instant."""
        return self.through([progress]).row(0)

    def through(self, instants: Sequence[Progress]) -> JointReference:
        """Return what is asked for at some instants; together they cost a fraction of one by one."""
        if self.spline is None:
            still = np.zeros((len(instants), len(self.first)))
            return JointReference(still + self.first, still, still)
        s, rate, acceleration = np.array([(p.value, p.rate, p.acceleration) for p in instants]).T[..., None]
        q, slope, curve = (np.asarray(self.spline(s[:, 0], order)) for order in range(3))
        return JointReference(q, slope * rate, curve * rate**2 + slope * acceleration)
