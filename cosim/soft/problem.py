"""What Newton's method minimises in one solution, and points of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

from cosim.frames import Array, Mask
from cosim.kernels import MASKS, MATRIX, REAL, kernel
from cosim.soft.body import Loads
from cosim.soft.system import Inertia, SoftSystem


@kernel(REAL(MATRIX, MASKS))
def _largest(values, counted):  # type: ignore[no-untyped-def]
    """Return the largest absolute value of those counted; 0 without any, NaN if one is not a number."""
    largest = 0.0
    for i in range(values.shape[0]):
        for r in range(3):
            size = abs(values[i, r])
            if counted[i, r] and not size <= largest:
                if size != size:
                    return size
                largest = size
    return largest


@final
@dataclass(frozen=True)
class Point:
    """Positions (n, 3) [m] with their potential [J] and residual [N]."""

    positions: Array
    energy: float
    residual: float


@final
@dataclass(frozen=True)
class Problem:
    """A potential under some loads; `system.gradient` belongs to the newest point of it.

    Args:
        system: assembled body.
        free: (n, 3) bool, components that move.
        loads: that act.
        tension: (segments,), see `SoftSystem.segment_tension`.
        inertia: of an implicit step; None in statics.
    """

    system: SoftSystem
    free: Mask
    loads: Loads
    tension: Array
    inertia: Inertia | None

    def at(self, positions: Array, angles: Array, *, hessian: bool = False) -> Point:
        """Return the point at positions (n, 3) [m]; hinge angles unwrap against those given (h,) [rad]."""
        energy = self.system.evaluate(
            positions, self.loads, self.tension, angles, inertia=self.inertia, hessian=hessian
        )
        return Point(positions, energy, _largest(self.system.gradient, self.free))

    @cached_property
    def kind(self) -> float:
        """Tells apart tangents that cannot stand for each other: statics, or the step's inertia."""
        return 0.0 if self.inertia is None else float(self.inertia.coefficient.sum())
