"""Rigid motion that best fits the motion of a group of nodes, and the deviation of nodes from it.

Any rotation gives a valid bound of the deviation; the one of least squares is used.
Source: Kabsch, Acta Cryst. A 32 (1976) 922; by Newton's iteration for the polar factor, Higham, SIAM J. Sci.
Stat. Comput. 7 (1986) 1160.
"""

import numpy as np

from cosim.base.kernel_types import Indices, Matrix
from cosim.base.kernels import device_function, kernel, zero_vector

_ITERATIONS_MAX = 30
_FLAT = 1e-9  # relative determinant below which the rotation is not defined


@kernel
def furthest_from_mean(values: Matrix) -> float:
    """Return the largest distance of a row of values (n, 3) from their mean."""
    mean, largest_square = zero_vector(3), 0.0
    for n in range(values.shape[0]):
        for r in range(3):
            mean[r] += values[n, r] / values.shape[0]
    for n in range(values.shape[0]):
        square = 0.0
        for r in range(3):
            square += (values[n, r] - mean[r]) ** 2
        largest_square = max(largest_square, square)
    return np.sqrt(largest_square)


@device_function
def _make_rotation(turn: Matrix, minors: Matrix) -> None:
    """Replace a matrix by the nearest rotation, or by the identity if that is not defined."""
    for _ in range(_ITERATIONS_MAX):
        size, area, determinant, change = 0.0, 0.0, 0.0, 0.0
        for r in range(3):
            a, b = (r + 1) % 3, (r + 2) % 3
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                minors[r, c] = turn[a, d] * turn[b, e] - turn[a, e] * turn[b, d]
                size, area = size + turn[r, c] * turn[r, c], area + minors[r, c] * minors[r, c]
            determinant += turn[r, 0] * minors[r, 0]
        if not determinant > _FLAT * size * np.sqrt(size):
            break
        scale = np.sqrt(np.sqrt(area / size) / determinant)
        for r in range(3):
            for c in range(3):
                value = 0.5 * (scale * turn[r, c] + minors[r, c] / (scale * determinant))
                change, turn[r, c] = max(change, abs(value - turn[r, c])), value
        if change < 1e-13:
            return
    for r in range(3):
        for c in range(3):
            turn[r, c] = 1.0 if r == c else 0.0


@device_function
def fit_motion(
    x: Matrix, before: Matrix, nodes: Indices, span: tuple[int, int, int], rigid: Matrix, minors: Matrix
) -> None:
    """Fill the means of some nodes, now and before, and the rotation in between, see `Units.rigid`.

    The span (begin, end, step) selects the nodes: a subset is enough, as any rigid motion is valid.
    """
    begin, end, step = span
    for r in range(2):
        for j in range(3):
            rigid[r, j] = 0.0
    weight = 1.0 / len(range(begin, end, step))
    for k in range(begin, end, step):
        n = nodes[k]
        for r in range(3):
            rigid[0, r] += weight * x[n, r]
            rigid[1, r] += weight * before[n, r]
    a, b, c, d, e, f, g, h, i = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(begin, end, step):
        n = nodes[k]
        u, v, w = before[n, 0] - rigid[1, 0], before[n, 1] - rigid[1, 1], before[n, 2] - rigid[1, 2]
        p, q, s = x[n, 0] - rigid[0, 0], x[n, 1] - rigid[0, 1], x[n, 2] - rigid[0, 2]
        a, b, c = a + p * u, b + p * v, c + p * w
        d, e, f = d + q * u, e + q * v, f + q * w
        g, h, i = g + s * u, h + s * v, i + s * w
    turn = rigid[2:]
    turn[0, 0], turn[0, 1], turn[0, 2] = a, b, c
    turn[1, 0], turn[1, 1], turn[1, 2] = d, e, f
    turn[2, 0], turn[2, 1], turn[2, 2] = g, h, i
    _make_rotation(turn, minors)


@device_function
def deviation(x: Matrix, before: Matrix, nodes: Indices, begin: int, end: int, rigid: Matrix) -> float:
    """Return the largest distance of some nodes from their positions by a rigid motion."""
    largest_square = 0.0
    for k in range(begin, end):
        square, n = 0.0, nodes[k]
        u, v, w = before[n, 0] - rigid[1, 0], before[n, 1] - rigid[1, 1], before[n, 2] - rigid[1, 2]
        for r in range(3):
            difference = (
                x[n, r] - rigid[0, r] - rigid[2 + r, 0] * u - rigid[2 + r, 1] * v - rigid[2 + r, 2] * w
            )
            square += difference * difference
        largest_square = max(largest_square, square)
    return np.sqrt(largest_square)


@device_function
def rigid_difference(one: Matrix, other: Matrix, radius: float) -> float:
    """Return the largest difference of two rigid motions in a ball around the mean of the other's nodes."""
    square_distance, square_turn = 0.0, 0.0
    for r in range(3):
        offset = other[0, r] - one[0, r]
        for c in range(3):
            offset -= one[2 + r, c] * (other[1, c] - one[1, c])
            square_turn += (other[2 + r, c] - one[2 + r, c]) ** 2
        square_distance += offset * offset
    return np.sqrt(square_distance) + radius * np.sqrt(0.5 * square_turn)
