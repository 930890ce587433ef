"""The one finite-difference checker: energy against gradient, gradient against Hessian.

Fourth-order central differences, f' = (8 (f(x+h) - f(x-h)) - (f(x+2h) - f(x-2h))) / (12 h). Their error is
about (h/l)^4 from truncation, l the length over which the term varies, and (l/h) 1e-16 from rounding.
With h near 1e-3 l both are far below the 1e-6 that tests ask for; second-order differences, at best
(1e-16)^(2/3) = 2e-11, have less room where a term is stiff.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.linear.pattern import BlockPattern

RELATIVE = 1e-6
"""Asked of every element: |exact - difference| / |exact|, Euclidean norms over the element's entries."""

Evaluate = Callable[[Array], tuple[float, Array, Array]]
"""Positions (n, 3) -> energy, gradient (n, 3), Hessian (3 n, 3 n)."""


def differences(function: Callable[[Array], Any], x: Array, step: float) -> Array:
    """Return the derivative of a function by each entry of x, as (x.size, *shape of the function)."""
    rows = []
    for index in np.ndindex(x.shape):
        values = []
        for offset in (1.0, -1.0, 2.0, -2.0):
            moved = x.copy()
            moved[index] += offset * step
            values.append(np.array(function(moved), dtype=np.float64))
        ahead, behind, far_ahead, far_behind = values
        rows.append((8.0 * (ahead - behind) - (far_ahead - far_behind)) / (12.0 * step))
    return np.array(rows)


def relative_error(exact: Array, approximate: Array) -> float:
    """Return |exact - approximate| / |exact|; infinite if exact is zero and approximate is not."""
    error, size = np.linalg.norm(exact - approximate), np.linalg.norm(exact)
    return float(error / size) if size > 0.0 else float(np.inf if error > 0.0 else 0.0)


def derivative_errors(evaluate: Evaluate, x: Array, step: float) -> tuple[float, float]:
    """Return the relative errors (gradient against energy, Hessian against gradient) at x."""
    _, gradient, hessian = evaluate(x)
    by_energy = differences(lambda y: evaluate(y)[0], x, step)
    by_gradient = differences(lambda y: evaluate(y)[1].ravel(), x, step)
    return relative_error(gradient.ravel(), by_energy), relative_error(hessian, by_gradient.T)


def dense(pattern: BlockPattern, blocks: Array) -> Array:
    """Return the whole matrix (3 n, 3 n) of lower node blocks."""
    full = np.zeros((pattern.nodes, 3, pattern.nodes, 3))
    full[pattern.column, :, pattern.row] = blocks.transpose(0, 2, 1)
    full[pattern.row, :, pattern.column] = blocks
    return full.reshape(3 * pattern.nodes, 3 * pattern.nodes)


def assembled(
    elements: IntArray, add: Callable[[Array, IntArray, Array, Array], float], nodes: int
) -> Evaluate:
    """Return the evaluation of a kernel on its own.

    Args:
        elements: (m, k) nodes of each element.
        add: (positions, slots, force, blocks) -> energy, as the kernels have it.
        nodes: in all.
    """
    pattern = BlockPattern.from_elements(nodes, [elements])
    slots = pattern.slots(elements)

    def evaluate(x: Array) -> tuple[float, Array, Array]:
        force, blocks = np.zeros((nodes, 3)), np.zeros((pattern.blocks, 3, 3))
        energy = add(np.ascontiguousarray(x), slots, force, blocks)
        return energy, force, dense(pattern, blocks)

    return evaluate
