"""A chain of rigid frames: energy, gradient and Hessian, and Newton's method on them.

A frame is four points (4, 3): its origin r [m] and its three unit axes. Strains of the section between
frames a and b, d = r_b - r_a, axes a_i and b_i:
    u_i = (a_i + b_i) . d / 2,    w_1 = (a_3 . b_2 - a_2 . b_3) / 2  and so on in cyclic order;
rigid motions leave them alone, and turning the chain around only changes signs. A change (dr, phi) of a
frame moves r by dr and turns its axes by exp(S(phi)); all derivatives are exact for that:
    second order of f . exp(S(phi)) v:   phi^T [(f v^T + v f^T) / 2 - (f . v) 1] phi / 2.
Beyond the limits of its samples a section's energy is infinite: Newton's method then takes a shorter step.
Masses, loads and cable eyelets are fixed to the frames: a point of local coordinates s is at r + sum s_i a_i.
Inertia of an implicit step is an elastic bed, as for nodes: c / 2 sum_ab M_ab (p_a - y_a) . (p_b - y_b).
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64

from cosim.kernels import inlined
from cosim.soft.section.energy import BENT, HIGH, LOW, section_energy

CUBE = float64[:, :, ::1]
FRAMES = float64[:, :, ::1]
FLAGS = boolean[::1]


@inlined
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inlined
def _add_skew(block, row, column, v, factor):  # type: ignore[no-untyped-def]
    """Add factor S(v) to a 3 x 3 part of a block."""
    block[row, column + 1] -= factor * v[2]
    block[row, column + 2] += factor * v[1]
    block[row + 1, column] += factor * v[2]
    block[row + 1, column + 2] -= factor * v[0]
    block[row + 2, column] -= factor * v[1]
    block[row + 2, column + 1] += factor * v[0]


@inlined
def _add_turning(block, f, v, factor):  # type: ignore[no-untyped-def]
    """Add factor [(f v^T + v f^T) / 2 - (f . v) 1] to the rotational part of a diagonal block."""
    inner = f[0] * v[0] + f[1] * v[1] + f[2] * v[2]
    for r in range(3):
        for c in range(3):
            block[3 + r, 3 + c] += factor * 0.5 * (f[r] * v[c] + v[r] * f[c])
        block[3 + r, 3 + r] -= factor * inner


@inlined
def _strains(a, b, d, x):  # type: ignore[no-untyped-def]
    for i in range(3):
        x[i] = 0.0
        j, k = (i + 1) % 3 + 1, (i + 2) % 3 + 1
        twist = 0.0
        for r in range(3):
            x[i] += 0.5 * (a[i + 1, r] + b[i + 1, r]) * d[r]
            twist += a[k, r] * b[j, r] - a[j, r] * b[k, r]
        x[3 + i] = 0.5 * twist


@inlined
def _strain_slopes(a, b, d, jac):  # type: ignore[no-untyped-def]
    """Fill jac (6, 9), d strains / d (r_b, phi_a, phi_b); r_a has the opposite sign of r_b."""
    v, v2 = np.empty(3), np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3 + 1, (i + 2) % 3 + 1
        _cross(a[i + 1], d, v)
        _cross(b[i + 1], d, v2)
        for r in range(3):
            jac[i, r] = 0.5 * (a[i + 1, r] + b[i + 1, r])
            jac[i, 3 + r] = 0.5 * v[r]
            jac[i, 6 + r] = 0.5 * v2[r]
        _cross(a[k], b[j], v)
        _cross(a[j], b[k], v2)
        for r in range(3):
            jac[3 + i, r] = 0.0
            jac[3 + i, 3 + r] = 0.5 * (v[r] - v2[r])
            jac[3 + i, 6 + r] = -jac[3 + i, 3 + r]


@inlined
def _add_section(a, b, c, inverse_length, out_a, out_b, block_a, block_b, off, s, hessian):  # type: ignore[no-untyped-def]
    """Add one section; off is the block of rows b and columns a. Returns its energy."""
    x, g, h, work, jac, turned = s
    d = np.empty(3)
    for r in range(3):
        d[r] = b[0, r] - a[0, r]
    _strains(a, b, d, x)
    place = x[2] * inverse_length - 1.0
    if not (c[LOW] <= place <= c[HIGH] and x[3] * x[3] + x[4] * x[4] <= c[BENT]):
        return np.inf
    energy = section_energy(c, x, inverse_length, g, h, work)
    _strain_slopes(a, b, d, jac)
    for i in range(6):
        for r in range(3):
            out_a[r] -= jac[i, r] * g[i]
            out_b[r] += jac[i, r] * g[i]
            out_a[3 + r] += jac[i, 3 + r] * g[i]
            out_b[3 + r] += jac[i, 6 + r] * g[i]
    if not hessian:
        return energy
    for i in range(6):
        for k in range(9):
            total = 0.0
            for j in range(6):
                total += h[i, j] * jac[j, k]
            turned[i, k] = total
    full = np.zeros((9, 9))
    for i in range(6):
        for k in range(9):
            for j in range(9):
                full[k, j] += jac[i, k] * turned[i, j]
    for r in range(3):
        for k in range(3):
            block_a[r, k] += full[r, k]
            block_b[r, k] += full[r, k]
            off[r, k] -= full[r, k]
            block_a[r, 3 + k] -= full[r, 3 + k]
            block_a[3 + r, k] -= full[3 + r, k]
            block_a[3 + r, 3 + k] += full[3 + r, 3 + k]
            block_b[r, 3 + k] += full[r, 6 + k]
            block_b[3 + r, k] += full[6 + r, k]
            block_b[3 + r, 3 + k] += full[6 + r, 6 + k]
            off[r, 3 + k] += full[r, 3 + k]
            off[3 + r, k] -= full[6 + r, k]
            off[3 + r, 3 + k] += full[6 + r, 3 + k]
    _add_geometric(a, b, d, g, block_a, block_b, off)
    return energy


@inlined
def _add_geometric(a, b, d, g, block_a, block_b, off):  # type: ignore[no-untyped-def]
    """Add the strains' own second derivatives times the energy's gradient."""
    va, vb = np.zeros(3), np.zeros(3)
    for i in range(3):
        for r in range(3):
            va[r] += g[i] * a[i + 1, r]
            vb[r] += g[i] * b[i + 1, r]
    # r-phi parts: u_i moves by (phi x a_i) . dr / 2
    _add_skew(block_a, 0, 3, va, 0.5)
    _add_skew(block_a, 3, 0, va, -0.5)
    _add_skew(off, 0, 3, va, -0.5)
    _add_skew(block_b, 0, 3, vb, -0.5)
    _add_skew(block_b, 3, 0, vb, 0.5)
    _add_skew(off, 3, 0, vb, -0.5)
    _add_turning(block_a, d, va, 0.5)
    _add_turning(block_b, d, vb, 0.5)
    n = np.zeros((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3 + 1, (i + 2) % 3 + 1
        for r in range(3):
            for c in range(3):
                n[r, c] += 0.5 * g[3 + i] * (a[k, r] * b[j, c] - a[j, r] * b[k, c])
    trace = n[0, 0] + n[1, 1] + n[2, 2]
    for r in range(3):
        for c in range(3):
            both = 0.5 * (n[r, c] + n[c, r])
            block_a[3 + r, 3 + c] += both
            block_b[3 + r, 3 + c] += both
            # rows phi_b, columns phi_a
            off[3 + r, 3 + c] -= n[r, c]
        block_a[3 + r, 3 + r] -= trace
        block_b[3 + r, 3 + r] -= trace
        off[3 + r, 3 + r] += trace


@inlined
def _add_frame(p, load, bed, mass, target, out, block, hessian):  # type: ignore[no-untyped-def]
    """Add dead loads and the inertial bed of one frame; return their energy."""
    energy = 0.0
    f, pull, v = np.empty(3), np.zeros(3), np.empty(3)
    for a in range(4):
        for r in range(3):
            f[r] = 0.0
        if bed != 0.0:
            for b in range(4):
                for r in range(3):
                    f[r] += bed * mass[a, b] * (p[b, r] - target[b, r])
            for r in range(3):
                energy += 0.5 * f[r] * (p[a, r] - target[a, r])
        for r in range(3):
            energy -= load[a, r] * p[a, r]
            f[r] -= load[a, r]
        if a == 0:
            for r in range(3):
                out[r] += f[r]
        else:
            _cross(p[a], f, v)
            for r in range(3):
                out[3 + r] += v[r]
            if hessian:
                _add_turning(block, f, p[a], 1.0)
    if bed != 0.0 and hessian:
        for a in range(1, 4):
            for r in range(3):
                pull[r] += bed * mass[0, a] * p[a, r]
        for r in range(3):
            block[r, r] += bed * mass[0, 0]
        _add_skew(block, 0, 3, pull, -1.0)
        _add_skew(block, 3, 0, pull, 1.0)
        for a in range(1, 4):
            for b in range(1, 4):
                weight = bed * mass[a, b]
                inner = p[a, 0] * p[b, 0] + p[a, 1] * p[b, 1] + p[a, 2] * p[b, 2]
                for r in range(3):
                    for c in range(3):
                        block[3 + r, 3 + c] -= weight * p[b, r] * p[a, c]
                    block[3 + r, 3 + r] += weight * inner
    return energy


@inlined
def _add_cable(a, b, s_a, s_b, tension, out_a, out_b, block_a, block_b, off, hessian):  # type: ignore[no-untyped-def]
    """Add one cable segment from an eyelet on frame a to one on frame b; return its energy."""
    qa, qb, t = np.zeros(3), np.zeros(3), np.empty(3)
    for i in range(3):
        for r in range(3):
            qa[r] += s_a[i] * a[i + 1, r]
            qb[r] += s_b[i] * b[i + 1, r]
    length = 0.0
    for r in range(3):
        t[r] = b[0, r] + qb[r] - a[0, r] - qa[r]
        length += t[r] * t[r]
    length = np.sqrt(length)
    for r in range(3):
        t[r] /= length
    jac = np.zeros((3, 12))  # of the step between the eyelets: -r_a, -phi_a x q_a, r_b, phi_b x q_b
    for r in range(3):
        jac[r, r], jac[r, 6 + r] = -1.0, 1.0
    _add_skew(jac, 0, 3, qa, 1.0)
    _add_skew(jac, 0, 9, qb, -1.0)
    for k in range(6):
        for r in range(3):
            out_a[k] += tension * t[r] * jac[r, k]
            out_b[k] += tension * t[r] * jac[r, 6 + k]
    if hessian:
        across = np.empty((3, 12))
        for k in range(12):
            along = t[0] * jac[0, k] + t[1] * jac[1, k] + t[2] * jac[2, k]
            for r in range(3):
                across[r, k] = tension / length * (jac[r, k] - t[r] * along)
        for i in range(6):
            for k in range(6):
                for r in range(3):
                    block_a[i, k] += jac[r, i] * across[r, k]
                    block_b[i, k] += jac[r, 6 + i] * across[r, 6 + k]
                    off[i, k] += jac[r, 6 + i] * across[r, k]
        _add_turning(block_a, t, qa, -tension)
        _add_turning(block_b, t, qb, tension)
    return tension * length
