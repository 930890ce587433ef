"""Film law on the engineering strains of a triangle's three edges, as bars would measure them.

An edge of drawn length L along the unit vector d has, under the Green strain E,
    q = d . E d = (l^2 / L^2 - 1) / 2,   s = (l - L) / L = 2 q / (1 + sqrt(1 + 2 q)).
The strain e = (e11, e22, 2 e12) is the one that a small uniform deformation with these s would have: Q e = s,
rows of Q = (d1^2, d2^2, d1 d2). The energy density is e : C : e / 2; at small strain it is the plain law.
The paper's triangles measure strain with bars (idea: Sim-FAST, Y. Zhu); the formula is ours.
"""

import math

from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function, small_matrix


@device_function
def _edge_maps(g: Matrix, rows: Matrix, columns: Matrix) -> None:
    """Fill rows (3, 3) with Q of the edges 0-1, 0-2 and 1-2, columns (3, 3) with its inverse's columns.

    The gradients of nodes 1 and 2 are the rows of the inverse of the edges 0-1 and 0-2: these two are,
    but for a common factor, (g2y, -g2x) and (-g1y, g1x).
    """
    for edge in range(3):
        along = across = 0.0
        if edge != 1:
            along, across = g[2, 1], -g[2, 0]
        if edge != 0:
            along, across = -g[1, 1] - along, g[1, 0] - across
        square = along * along + across * across
        rows[edge, 0] = along * along / square
        rows[edge, 1] = across * across / square
        rows[edge, 2] = along * across / square
    for edge in range(3):
        a, b = (edge + 1) % 3, (edge + 2) % 3
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            columns[edge, r] = rows[a, s] * rows[b, t] - rows[a, t] * rows[b, s]
    determinant = rows[0, 0] * columns[0, 0] + rows[0, 1] * columns[0, 1] + rows[0, 2] * columns[0, 2]
    for edge in range(3):
        for r in range(3):
            columns[edge, r] /= determinant


@device_function
def edge_strain(
    strain: tuple[float, float, float], g: Matrix, stiffness: Matrix, n: Vector, c: Matrix
) -> float:
    """Fill n (3,) and c (3, 3), first and second derivative of the energy density by (E11, E22, 2 E12).

    With p = d(density)/ds and a = ds/dq = L / l:
        n = sum_i p_i a_i Q_i,   c = sum_ij a_i a_j K_ij Q_i Q_j^T - sum_i p_i a_i^3 Q_i Q_i^T,
        K = Q^-T C Q^-1.

    Args:
        strain: E11, E22, 2 E12.
        g: (3, 2) [1/m], shape gradients.
        stiffness: (3, 3) [N/m].
        n: filled.
        c: filled.

    Returns:
        Energy density [J/m^2].
    """
    e11, e22, e12 = strain
    rows, columns = small_matrix(3, 3), small_matrix(3, 3)
    _edge_maps(g, rows, columns)
    strain0 = strain1 = strain2 = 0.0
    for i in range(3):
        q = rows[i, 0] * e11 + rows[i, 1] * e22 + rows[i, 2] * e12
        s = 2.0 * q / (1.0 + math.sqrt(1.0 + 2.0 * q))
        strain0 += columns[i, 0] * s
        strain1 += columns[i, 1] * s
        strain2 += columns[i, 2] * s
    stress0 = stiffness[0, 0] * strain0 + stiffness[0, 1] * strain1 + stiffness[0, 2] * strain2
    stress1 = stiffness[1, 0] * strain0 + stiffness[1, 1] * strain1 + stiffness[1, 2] * strain2
    stress2 = stiffness[2, 0] * strain0 + stiffness[2, 1] * strain1 + stiffness[2, 2] * strain2
    n[:] = 0.0
    c[:] = 0.0
    for i in range(3):
        slope_i = 1.0 / math.sqrt(1.0 + 2.0 * (rows[i, 0] * e11 + rows[i, 1] * e22 + rows[i, 2] * e12))
        p = columns[i, 0] * stress0 + columns[i, 1] * stress1 + columns[i, 2] * stress2
        for r in range(3):
            n[r] += p * slope_i * rows[i, r]
        for j in range(3):
            slope_j = 1.0 / math.sqrt(1.0 + 2.0 * (rows[j, 0] * e11 + rows[j, 1] * e22 + rows[j, 2] * e12))
            pair = 0.0
            for r in range(3):
                for s in range(3):
                    pair += columns[i, r] * stiffness[r, s] * columns[j, s]
            pair *= slope_i * slope_j
            if i == j:
                pair -= p * slope_i**3
            for r in range(3):
                for s in range(3):
                    c[r, s] += pair * rows[i, r] * rows[j, s]
    return 0.5 * (strain0 * stress0 + strain1 * stress1 + strain2 * stress2)
