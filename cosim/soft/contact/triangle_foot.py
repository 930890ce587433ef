"""The distance of a point from a triangle's plane, and its foot as barycentric weights of the corners.

With n the unit normal and A the area, the weight of corner j has the gradient n x e_j / (2 A), e_j the edge
across from it.
"""

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector


@device_function
def plane_of(x: Matrix, corners: Indices, n: Vector) -> float:
    """Fill a triangle's unit normal; return the reciprocal of twice its area."""
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    n[0], n[1], n[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    shrink = 1.0 / np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    n[0], n[1], n[2] = shrink * n[0], shrink * n[1], shrink * n[2]
    return shrink


@device_function
def fill_slopes(x: Matrix, corners: Indices, n: Vector, shrink: float, slope: Matrix) -> None:
    """Fill the gradients of the weights of a foot, from the results of `plane_of`."""
    for j in range(3):
        b, c = corners[(j + 1) % 3], corners[(j + 2) % 3]
        ex, ey, ez = shrink * (x[c, 0] - x[b, 0]), shrink * (x[c, 1] - x[b, 1]), shrink * (x[c, 2] - x[b, 2])
        slope[j, 0] = n[1] * ez - n[2] * ey
        slope[j, 1] = n[2] * ex - n[0] * ez
        slope[j, 2] = n[0] * ey - n[1] * ex


@device_function
def fill_weights(x: Matrix, corners: Indices, slope: Matrix, y: Vector, weight: Vector) -> None:
    """Fill the weights of a point's foot."""
    for j in range(3):
        b, weight[j] = corners[(j + 1) % 3], 0.0
        for r in range(3):
            weight[j] += slope[j, r] * (y[r] - x[b, r])


@device_function
def fill_point(x: Matrix, nodes: Indices, weights: Vector, y: Vector) -> None:
    """Fill the position of a point that combines three nodes."""
    a, b, c = nodes[0], nodes[1], nodes[2]
    for r in range(3):
        y[r] = weights[0] * x[a, r] + weights[1] * x[b, r] + weights[2] * x[c, r]


@device_function
def distance_of(x: Matrix, corner: int, n: Vector, y: Vector) -> float:
    """Return the distance of a point from the plane through a corner, positive in front."""
    return n[0] * (y[0] - x[corner, 0]) + n[1] * (y[1] - x[corner, 1]) + n[2] * (y[2] - x[corner, 2])


@kernel
def _feet(
    x: Matrix, nodes: IndexTable, weights: Matrix, foot: Matrix, normal: Matrix, distance: Vector
) -> None:
    y, slope = small_vector(3), small_matrix(3, 3)
    for e in range(nodes.shape[0]):
        fill_point(x, nodes[e], weights[e], y)
        shrink = plane_of(x, nodes[e, 3:], normal[e])
        fill_slopes(x, nodes[e, 3:], normal[e], shrink, slope)
        fill_weights(x, nodes[e, 3:], slope, y, foot[e])
        distance[e] = distance_of(x, nodes[e, 3], normal[e], y)


def feet(positions: Array, nodes: IntArray, weights: Array) -> tuple[Array, Array, Array]:
    """Return weights of feet (k, 3), normals (k, 3) and distances (k,) [m] of points over triangles.

    Args:
        positions: (n, 3) [m].
        nodes: (k, 6), three of each point and of its triangle.
        weights: (k, 3) of the point.
    """
    foot, normal, distance = np.empty((len(nodes), 3)), np.empty((len(nodes), 3)), np.empty(len(nodes))
    _feet(positions, nodes, weights, foot, normal, distance)
    return foot, normal, distance
