"""Gravity and the inertia of an implicit step on nodal masses, and the moments of a mass spread over points.

gravity:  energy = -sum m g . x,            gradient = -m g,
inertia:  energy = sum c |x - y|^2 / 2,     gradient = c (x - y),     Hessian = c 1;
moments:  mass = sum_b M_b00,   first = sum_b sum_k M_b0k p_bk,   second = sum_b sum_jk M_bjk p_bj p_bk^T,
with M_b the mass matrix of block b in weights of its points p_bk, of which the first is its origin. For nodes
a block is one point, and M_b its mass; frames carry a ring together on their points.
"""

from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import kernel


@kernel
def add_gravity(x: Matrix, mass: Vector, gravity: Vector, gradient: Matrix) -> float:
    """Add the weight's potential to gradient; return that potential [J]."""
    energy = 0.0
    for i in range(x.shape[0]):
        for r in range(3):
            weight = mass[i] * gravity[r]
            gradient[i, r] -= weight
            energy -= weight * x[i, r]
    return energy


@kernel
def add_inertia(
    x: Matrix, coefficient: Vector, target: Matrix, diagonal: Indices, gradient: Matrix, blocks: Blocks
) -> float:
    """Add the inertia term to gradient, its Hessian to the diagonal blocks if any are named.

    Returns its energy [J].
    """
    with_hessian = diagonal.shape[0] > 0
    energy = 0.0
    for i in range(x.shape[0]):
        c = coefficient[i]
        for r in range(3):
            offset = x[i, r] - target[i, r]
            gradient[i, r] += c * offset
            energy += 0.5 * c * offset * offset
            if with_hessian:
                blocks[diagonal[i], r, r] += c
    return energy


@kernel
def mass_moments(mass: Blocks, points: Blocks, moments: Vector) -> float:
    """Set moments (9,) to the first ones, and xx, xy, xz, yy, yz, zz of the second; return the mass [kg].

    Args:
        mass: M (b, k, k) [kg], symmetric.
        points: (b, k, 3) [m].
        moments: (9,) [kg m] and [kg m^2].
    """
    total = x = y = z = xx = xy = xz = yy = yz = zz = 0.0
    for b in range(points.shape[0]):
        total += mass[b, 0, 0]
        for j in range(points.shape[1]):
            u = v = w = 0.0
            for k in range(points.shape[1]):
                u += mass[b, j, k] * points[b, k, 0]
                v += mass[b, j, k] * points[b, k, 1]
                w += mass[b, j, k] * points[b, k, 2]
            if j == 0:
                x, y, z = x + u, y + v, z + w
            xx += points[b, j, 0] * u
            xy += points[b, j, 0] * v
            xz += points[b, j, 0] * w
            yy += points[b, j, 1] * v
            yz += points[b, j, 1] * w
            zz += points[b, j, 2] * w
    moments[0], moments[1], moments[2] = x, y, z
    moments[3], moments[4], moments[5] = xx, xy, xz
    moments[6], moments[7], moments[8] = yy, yz, zz
    return total
