"""Strain of a film triangle and the node blocks of its Hessian; formulas: see `membrane`."""

from __future__ import annotations

from cosim.base.kernels import device_function


@device_function
def deformation(x, triangle, g, f):  # type: ignore[no-untyped-def]
    """Fill f = F^T (2, 3) for one triangle and return E11, E22, 2 E12."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    for k in range(3):
        d1 = x[b, k] - x[a, k]
        d2 = x[c, k] - x[a, k]
        f[0, k] = d1 * g[1, 0] + d2 * g[2, 0]
        f[1, k] = d1 * g[1, 1] + d2 * g[2, 1]
    e11 = 0.5 * (f[0, 0] * f[0, 0] + f[0, 1] * f[0, 1] + f[0, 2] * f[0, 2] - 1.0)
    e22 = 0.5 * (f[1, 0] * f[1, 0] + f[1, 1] * f[1, 1] + f[1, 2] * f[1, 2] - 1.0)
    e12 = f[0, 0] * f[1, 0] + f[0, 1] * f[1, 1] + f[0, 2] * f[1, 2]
    return e11, e22, e12


@device_function
def pair_block(f, stiffness, ga, gb, geometric, area, out):  # type: ignore[no-untyped-def]
    """Fill out = area (geometric 1 + B_a^T C B_b) with B_a = u1_a f1^T + u2_a f2^T."""
    # C u_q for u_1 = (gb0, 0, gb1) and u_2 = (0, gb1, gb0), in the strain components (E11, E22, 2 E12)
    p0 = stiffness[0, 0] * gb[0] + stiffness[0, 2] * gb[1]
    p1 = stiffness[1, 0] * gb[0] + stiffness[1, 2] * gb[1]
    p2 = stiffness[2, 0] * gb[0] + stiffness[2, 2] * gb[1]
    q0 = stiffness[0, 1] * gb[1] + stiffness[0, 2] * gb[0]
    q1 = stiffness[1, 1] * gb[1] + stiffness[1, 2] * gb[0]
    q2 = stiffness[2, 1] * gb[1] + stiffness[2, 2] * gb[0]
    c11 = area * (ga[0] * p0 + ga[1] * p2)
    c21 = area * (ga[1] * p1 + ga[0] * p2)
    c12 = area * (ga[0] * q0 + ga[1] * q2)
    c22 = area * (ga[1] * q1 + ga[0] * q2)
    for r in range(3):
        left1 = f[0, r] * c11 + f[1, r] * c21
        left2 = f[0, r] * c12 + f[1, r] * c22
        for c in range(3):
            out[r, c] = left1 * f[0, c] + left2 * f[1, c]
        out[r, r] += area * geometric


@device_function
def first_node_blocks(k11, k21, k22, k10, k20, k00):  # type: ignore[no-untyped-def]
    """Fill the blocks of node 0: the gradients g_a sum to zero, so they follow from the others."""
    for r in range(3):
        for c in range(3):
            k10[r, c] = -k11[r, c] - k21[c, r]
            k20[r, c] = -k21[r, c] - k22[r, c]
    for r in range(3):
        for c in range(3):
            k00[r, c] = -k10[r, c] - k20[r, c]
