"""Gravity and the inertia of an implicit step on nodal masses.

gravity:  energy = -sum m g . x,            gradient = -m g,
inertia:  energy = sum c |x - y|^2 / 2,     gradient = c (x - y),     Hessian = c 1.
"""

from __future__ import annotations

from cosim.base.frames import Array
from cosim.base.kernels import BLOCKS, INDICES, MATRIX, REAL, VECTOR, kernel


@kernel(REAL(MATRIX, VECTOR, VECTOR, MATRIX))
def add_gravity(x: Array, mass: Array, gravity: Array, force: Array) -> float:
    """Add the gradient of the weight's potential to force; return that potential [J]."""
    energy = 0.0
    for i in range(x.shape[0]):
        for r in range(3):
            weight = mass[i] * gravity[r]
            force[i, r] -= weight
            energy -= weight * x[i, r]
    return energy


@kernel(REAL(MATRIX, VECTOR, MATRIX, INDICES, MATRIX, BLOCKS))
def add_inertia(x, coefficient, target, diagonal, force, blocks):  # type: ignore[no-untyped-def]
    """Add the gradient of the inertial bed to force, its Hessian to the diagonal blocks if any are named.

    Returns its energy [J].
    """
    with_hessian = diagonal.shape[0] > 0
    energy = 0.0
    for i in range(x.shape[0]):
        c = coefficient[i]
        for r in range(3):
            offset = x[i, r] - target[i, r]
            force[i, r] += c * offset
            energy += 0.5 * c * offset * offset
            if with_hessian:
                blocks[diagonal[i], r, r] += c
    return energy
