"""Secant pairs of steps with a reused factorisation: limited-memory BFGS on top of that factor.

A step s and the change y of the gradient along it correct the inverse H by (rho = 1 / (s . y))
    H <- (1 - rho s y^T) H (1 - rho y s^T) + rho s s^T,
pair after pair; the product with a load takes one solution with the factor and four sums per pair. Pairs
whose s . y is not positive are left out, so that H stays positive definite.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., algorithm 7.4; on top of a factor of finite
elements: Matthies and Strang, Int. J. Numer. Meth. Eng. 14 (1979) 1613.
"""

from typing import Final, NamedTuple

import numpy as np

from cosim.base.kernel_types import Masks, Matrix, Vector
from cosim.base.kernels import kernel

_MOST: Final = 8
FAR: Final = 10.0
"""Growth of the residual above which a step's secant is useless for the tangent at its start."""
_LEAST_COSINE: Final = 1e-6  # between step and change of the gradient; below it may be rounding only


class SecantPairs(NamedTuple):
    """The m newest pairs; pair k is in row k modulo m.

    Args:
        step: (m, 3 n) [m].
        change: (m, 3 n) [N], of the gradient along it.
        scale: (m,) [1/J], rho.
        factor: (m,), scratch.
    """

    step: Matrix
    change: Matrix
    scale: Vector
    factor: Vector

    @classmethod
    def empty(cls, nodes: int) -> "SecantPairs":
        """Return allocated arrays for the pairs of a body, given its number of nodes."""
        return cls(
            np.empty((_MOST, 3 * nodes)), np.empty((_MOST, 3 * nodes)), np.empty(_MOST), np.empty(_MOST)
        )


@kernel(reorder_sums=True)
def secant_load(pairs: SecantPairs, count: int, gradient: Matrix, load: Matrix) -> None:
    """Fill the load (n, 3) [N] for the solution with the factor: first loop of the two-loop recursion.

    Args:
        pairs: of steps.
        count: number of pairs so far.
        gradient: (n, 3) [N].
        load: filled: minus the gradient, less its part along the pairs.
    """
    room, force, slope = pairs.scale.shape[0], load.reshape(load.size), gradient.reshape(gradient.size)
    for i in range(force.shape[0]):
        force[i] = -slope[i]
    for k in range(count - 1, max(count - room, 0) - 1, -1):
        m, work = k % room, 0.0
        step, change = pairs.step[m], pairs.change[m]
        for i in range(force.shape[0]):
            work += step[i] * force[i]
        factor = pairs.factor[m] = pairs.scale[m] * work
        for i in range(force.shape[0]):
            force[i] -= factor * change[i]


@kernel(reorder_sums=True)
def secant_step(pairs: SecantPairs, count: int, solution: Matrix) -> None:
    """Correct a solution (n, 3) [m] under such a load to the step: second loop of the recursion."""
    room, flat_solution = pairs.scale.shape[0], solution.reshape(solution.size)
    for k in range(max(count - room, 0), count):
        m, work = k % room, 0.0
        step, change = pairs.step[m], pairs.change[m]
        for i in range(flat_solution.shape[0]):
            work += change[i] * flat_solution[i]
        lacking = pairs.factor[m] - pairs.scale[m] * work
        for i in range(flat_solution.shape[0]):
            flat_solution[i] += lacking * step[i]


@kernel(reorder_sums=True)
def add_pair(
    pairs: SecantPairs, count: int, taken: Matrix, before: Matrix, gradient: Matrix, free: Masks
) -> int:
    """Store a step and the change of the gradient along it; return the new number of pairs.

    Args:
        pairs: of steps.
        count: number of pairs so far.
        taken: (n, 3) [m], the step.
        before: (n, 3) [N], gradient at its start.
        gradient: (n, 3) [N], at its end.
        free: (n, 3), components that count.
    """
    m = count % pairs.scale.shape[0]
    step, change = pairs.step[m], pairs.change[m]
    work, length, size = 0.0, 0.0, 0.0
    for i in range(taken.shape[0]):
        for r in range(3):
            component = taken[i, r]
            gradient_change = gradient[i, r] - before[i, r] if free[i, r] else 0.0
            step[3 * i + r], change[3 * i + r] = component, gradient_change
            work += component * gradient_change
            length += component * component
            size += gradient_change * gradient_change
    if not work > _LEAST_COSINE * np.sqrt(length * size):
        return count
    pairs.scale[m] = 1.0 / work
    return count + 1
