"""Precomputed plane of a triangle, for the distance and foot of many points.

The side (13,) holds the first corner, the normal n, the gradients of the weights b and c of the other
corners, and twice the area. A point p is at distance (p - corner) . n; its foot has weights 1 - b - c, b, c.
"""

import numpy as np

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import device_function, small_matrix, small_vector
from cosim.soft.contact import triangle_foot


@device_function
def measure_side(x: Matrix, corners: Indices, side: Vector) -> None:
    """Fill the side (13,) of a triangle."""
    n, slope = small_vector(3), small_matrix(3, 3)
    shrink = triangle_foot.plane_of(x, corners, n)
    triangle_foot.fill_slopes(x, corners, n, shrink, slope)
    side[12] = 1.0 / shrink
    for r in range(3):
        side[r], side[3 + r] = x[corners[0], r], n[r]
        side[6 + r], side[9 + r] = slope[1, r], slope[2, r]


@device_function
def over_plane(side: Vector, x: float, y: float, z: float) -> float:
    """Return a point's distance from a triangle's plane."""
    x, y, z = x - side[0], y - side[1], z - side[2]
    return side[3] * x + side[4] * y + side[5] * z


@device_function
def least_weight(side: Vector, x: float, y: float, z: float) -> float:
    """Return the smallest barycentric weight of a point's foot on a triangle's plane."""
    x, y, z = x - side[0], y - side[1], z - side[2]
    b, c = side[6] * x + side[7] * y + side[8] * z, side[9] * x + side[10] * y + side[11] * z
    return min(1.0 - b - c, b, c)


@device_function
def steepest_slope(side: Vector) -> float:
    """Return the largest gradient of a weight, the reciprocal of a triangle's smallest height."""
    first, second, both = 0.0, 0.0, 0.0
    for r in range(6, 9):
        first, second = first + side[r] * side[r], second + side[3 + r] * side[3 + r]
        both += (side[r] + side[3 + r]) ** 2
    return np.sqrt(max(first, second, both))
