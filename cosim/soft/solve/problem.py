"""What Newton's method minimises in one solution, and points of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol, final

from cosim.base.frames import Array, Mask
from cosim.base.kernels import BOOLEAN, MASKS, MATRIX, REAL, kernel
from cosim.soft.body.loads import Loads
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.solve.assembly import SoftSystem

RESULTANT_SHARE: Final = 1e-2
"""Of the resultant force, or of the moment over the body's size, that counts as a residual."""

MUCH_LESS: Final = 0.1
"""Share of a residual to which a step has to bring it that does not lower the potential."""


@kernel(REAL(MATRIX, MATRIX, MASKS))
def largest_residual(x: Array, values: Array, counted: Mask) -> float:
    """Return the largest component of those counted, or the share of their resultant where that is larger.

    Many small forces of one sign add up to a wrench that is not there. NaN if a component is not a number.
    """
    largest, size = 0.0, 0.0
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(values.shape[0]):
        gx = values[i, 0] if counted[i, 0] else 0.0
        gy = values[i, 1] if counted[i, 1] else 0.0
        gz = values[i, 2] if counted[i, 2] else 0.0
        most = max(abs(gx), abs(gy), abs(gz))
        if gx != gx or gy != gy or gz != gz:
            return math.nan
        largest = max(largest, most)
        rx, ry, rz = x[i, 0] - x[0, 0], x[i, 1] - x[0, 1], x[i, 2] - x[0, 2]
        size = max(size, rx * rx + ry * ry + rz * rz)
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        mx, my, mz = mx + ry * gz - rz * gy, my + rz * gx - rx * gz, mz + rx * gy - ry * gx
    force, moment = math.sqrt(fx * fx + fy * fy + fz * fz), math.sqrt(mx * mx + my * my + mz * mz)
    if size > 0.0:
        force = max(force, moment / math.sqrt(size))
    return max(largest, RESULTANT_SHARE * force)


@kernel(BOOLEAN(REAL, REAL, REAL, REAL, REAL), taken_in=True)
def falls_enough(energy: float, before: float, slope: float, residual: float, residual_before: float) -> bool:
    """Return whether a step lowers a potential by its slope's share, or the residual by far.

    Args:
        energy: [J], where it ends.
        before: [J], where it begins.
        slope: [J], the gradient there times the step.
        residual: [N], where it ends.
        residual_before: [N].
    """
    rounding = 1e-13 * (1.0 + abs(before))  # what it can hide in a sum of terms of this size
    falls = energy <= before + 1e-4 * slope + rounding
    return falls or (math.isfinite(energy) and residual < MUCH_LESS * residual_before)


@final
@dataclass(frozen=True)
class Point:
    """Positions (n, 3) [m] with their potential [J] and residual [N]."""

    positions: Array
    energy: float
    residual: float


class Potential(Protocol):
    """What an iteration with a new tangent lowers: that of a whole body, or of a part of it."""

    @property
    def kind(self) -> float:
        """Tells apart tangents that cannot stand for each other."""

    def at(self, positions: Array, memory: Array, *, hessian: bool = False) -> Point:
        """Return the point at positions (n, 3) [m], its gradient in the system, its tangent if asked for."""


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

    def at(self, positions: Array, memory: Array, *, hessian: bool = False) -> Point:
        """Return the point at positions (n, 3) [m]; elements remember (values,) the last accepted one."""
        energy = self.system.evaluate(
            positions, self.loads, self.tension, memory, inertia=self.inertia, hessian=hessian
        )
        return Point(positions, energy, largest_residual(positions, self.system.gradient, self.free))

    def begin(self, positions: Array, memory: Array) -> Point:
        """Return the point where a solution begins, the elements' own unknowns looked at anew in statics.

        A ring of beams on a saddle would stay there otherwise; in motion it is left by itself.
        """
        inertia = self.inertia
        moving = inertia is not None and inertia.step_s < math.inf and not inertia.closely
        return self.at(positions, memory if moving else self.system.fresh(memory))

    @cached_property
    def kind(self) -> float:
        """Tells apart tangents that cannot stand for each other: statics, or the step's inertia."""
        return 0.0 if self.inertia is None else float(self.inertia.coefficient.sum())
