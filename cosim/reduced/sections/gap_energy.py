"""The part of a section's energy with which square units fold: functions of the gaps between their rims. A
square's film responds differently along sides and diagonals, and stiffens as rims close. So the energy of a
section between square frames has the sum F = sum_k sum_i f_k(y_ki) over places on its rim, with y = g / (g +
l), the gap g = u_3 + w_1 y_i - w_2 x_i [m] between the two frames at the place (x_i, y_i), and l = R / 5. The
places are the corners (k = 1), the middles of the sides (2), and halfway to the corners (3). Each f_k is a
uniform cubic spline, fine where rims are near. Source of the splines: de Boor, A Practical Guide to Splines,
chapter IX.
"""

import math
from typing import Final

from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function
from cosim.reduced.sections.coefficients import GAP_INTERVALS, GAP_KINDS, POLYNOMIAL

_LOW: Final = -0.1  # of y: rims may overlap a little, because the film between them yields
_HIGH: Final = 0.8
_REACH: Final = 0.2
_OVERLAP: Final = 0.3  # of l; the energy of a larger overlap is infinite
_FUNCTIONS: Final = GAP_INTERVALS + 3


@device_function
def _cubic(c: Matrix, s: int, first: int, position: float) -> tuple[float, float, float]:
    """Return value, slope and curvature of the spline c[s, first:], knots one apart, at a place."""
    at = min(max(int(position), 0), GAP_INTERVALS - 1)
    u = position - at
    v, k = 1.0 - u, first + at
    a, b, d, e = c[s, k], c[s, k + 1], c[s, k + 2], c[s, k + 3]
    value = a * v * v * v + b * (3.0 * u * u * u - 6.0 * u * u + 4.0)
    value += d * (3.0 * v * v * v - 6.0 * v * v + 4.0) + e * u * u * u
    slope = -a * v * v + b * (3.0 * u * u - 4.0 * u) + d * (4.0 * v - 3.0 * v * v) + e * u * u
    curvature = a * v + b * (3.0 * u - 2.0) + d * (3.0 * v - 2.0) + e * u
    return value / 6.0, 0.5 * slope, curvature


@device_function
def _place(rim: Matrix, kind: int, i: int) -> tuple[float, float]:
    """Return the coordinates [m] of a place on a frame with corners rim (n, 2)."""
    x, y = rim[i, 0], rim[i, 1]
    if kind == 1:
        k = (i + 1) % rim.shape[0]
        return 0.5 * (x + rim[k, 0]), 0.5 * (y + rim[k, 1])
    return (x, y) if kind == 0 else (0.5 * x, 0.5 * y)


@device_function
def add_gaps(c: Matrix, s: int, x: Vector, rim: Matrix, gradient: Vector, hessian: Matrix) -> float:
    """Return F, infinite where rims overlap; add its gradient and, unless `hessian` is empty, its Hessian.

    Args:
        c: (sections, COEFFICIENTS or more).
        s: which section.
        x: (6,) strains.
        rim: (n, 2) [m], corners of the frames; zero, or (0, 2), for none.
        gradient: (6,).
        hessian: (6, 6); (0, 6) if it is not needed.
    """
    energy = 0.0
    if rim.shape[0] == 0 or rim[0, 0] == 0.0 == rim[0, 1]:
        return energy
    reach, per = _REACH * math.hypot(rim[0, 0], rim[0, 1]), GAP_INTERVALS / (_HIGH - _LOW)
    for kind in range(GAP_KINDS):
        for i in range(rim.shape[0]):
            along, across = _place(rim, kind, i)
            gap = x[2] + x[3] * across - x[4] * along
            if gap < -_OVERLAP * reach:
                return math.inf
            inverse = 1.0 / (gap + reach)
            rate = per * reach * inverse * inverse
            first = POLYNOMIAL + kind * _FUNCTIONS
            value, slope, curvature = _cubic(c, s, first, per * (gap * inverse - _LOW))
            energy += value
            pull = slope * rate
            gradient[2] += pull
            gradient[3] += pull * across
            gradient[4] -= pull * along
            if hessian.shape[0] > 0:
                stiff = curvature * rate * rate - 2.0 * pull * inverse
                hessian[2, 2] += stiff
                hessian[3, 3] += stiff * across * across
                hessian[4, 4] += stiff * along * along
                for row, column, factor in ((3, 2, across), (4, 2, -along), (4, 3, -along * across)):
                    hessian[row, column] += stiff * factor
                    hessian[column, row] += stiff * factor
    return energy
