"""Vector operations of a Newton iteration: largest component, fraction of a step, work, largest residual."""

import math
from typing import Final

from cosim.base.kernel_types import Masks, Matrix
from cosim.base.kernels import kernel

RESULTANT_FRACTION: Final = 1e-2
"""Fraction of the resultant force, or of the moment over the body's size, that counts as a residual."""


@kernel
def longest(step: Matrix) -> float:
    """Return the largest component of a step (n, 3), NaN if one is not a number."""
    largest = 0.0
    for i in range(step.shape[0]):
        for r in range(3):
            if math.isnan(step[i, r]):
                return math.nan
            largest = max(largest, abs(step[i, r]))
    return largest


@kernel
def advance(start: Matrix, fraction: float, step: Matrix, x: Matrix) -> None:
    """Fill x = start + fraction step, (n, 3) each."""
    for i in range(x.shape[0]):
        for r in range(3):
            x[i, r] = start[i, r] + fraction * step[i, r]


@kernel
def work_along(force: Matrix, step: Matrix) -> float:
    """Return force . step, (n, 3) each."""
    work = 0.0
    for i in range(force.shape[0]):
        for r in range(3):
            work += force[i, r] * step[i, r]
    return work


@kernel
def largest_residual(x: Matrix, values: Matrix, counted: Masks) -> float:
    """Return the largest counted component, or a fraction of the resultant if that is larger.

    Many small forces of one sign add up to a spurious wrench. NaN if a component is not a number.
    """
    largest, size = 0.0, 0.0
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(values.shape[0]):
        gx = values[i, 0] if counted[i, 0] else 0.0
        gy = values[i, 1] if counted[i, 1] else 0.0
        gz = values[i, 2] if counted[i, 2] else 0.0
        node_size = max(abs(gx), abs(gy), abs(gz))
        if gx != gx or gy != gy or gz != gz:
            return math.nan
        largest = max(largest, node_size)
        rx, ry, rz = x[i, 0] - x[0, 0], x[i, 1] - x[0, 1], x[i, 2] - x[0, 2]
        size = max(size, rx * rx + ry * ry + rz * rz)
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        mx, my, mz = mx + ry * gz - rz * gy, my + rz * gx - rx * gz, mz + rx * gy - ry * gx
    force, moment = math.sqrt(fx * fx + fy * fy + fz * fz), math.sqrt(mx * mx + my * my + mz * mz)
    if size > 0.0:
        force = max(force, moment / math.sqrt(size))
    return max(largest, RESULTANT_FRACTION * force)
