"""A chain of rigid frames: energy, gradient and Hessian of the sections between them.

A frame is four points (4, 3): its origin r [m] and its three unit axes. Strains of the section between
frames a and b, d = r_b - r_a, axes a_i and b_i:
    u_i = (a_i + b_i) . d / 2,    w_1 = (a_3 . b_2 - a_2 . b_3) / 2  and so on in cyclic order;
rigid motions leave them alone, and turning the chain around only changes signs. A change (dr, phi) of a
frame moves r by dr and turns its axes by exp(S(phi)); all derivatives are exact for that:
    second order of f . exp(S(phi)) v:   phi^T [(f v^T + v f^T) / 2 - (f . v) 1] phi / 2.
Beyond the limits of its samples a section's energy is infinite: Newton's method then takes a shorter step.

Kernels get whole arrays and an index, not rows: a row is an object of its own, which costs more than what
is done with it.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64

from cosim.base.kernels import device_function, small_matrix, small_vector
from cosim.reduced.sections.section_energy import BENT, HIGH, LOW, section_energy

CUBE = float64[:, :, ::1]
FLAGS = boolean[::1]


@device_function
def add_skew(block, f, row, column, x, y, z):  # type: ignore[no-untyped-def]
    """Add S((x, y, z)) to a 3 x 3 part of block f."""
    block[f, row, column + 1] -= z
    block[f, row, column + 2] += y
    block[f, row + 1, column] += z
    block[f, row + 1, column + 2] -= x
    block[f, row + 2, column] -= y
    block[f, row + 2, column + 1] += x


@device_function
def add_turning(block, f, n, factor):  # type: ignore[no-untyped-def]
    """Add factor [(n + n^T) / 2 - (trace n) 1] to the rotational part of block f, n (3, 3) a sum of f v^T."""
    trace = n[0, 0] + n[1, 1] + n[2, 2]
    for r in range(3):
        for c in range(3):
            block[f, 3 + r, 3 + c] += 0.5 * factor * (n[r, c] + n[c, r])
        block[f, 3 + r, 3 + r] -= factor * trace


@device_function
def section_strains(frames, s, d, x):  # type: ignore[no-untyped-def]
    """Fill d (3,) and the strains x (6,) of section s."""
    for r in range(3):
        d[r] = frames[s + 1, 0, r] - frames[s, 0, r]
    for i in range(3):
        stretch = twist = 0.0
        j, k = (i + 1) % 3 + 1, (i + 2) % 3 + 1
        for r in range(3):
            stretch += (frames[s, i + 1, r] + frames[s + 1, i + 1, r]) * d[r]
            twist += frames[s, k, r] * frames[s + 1, j, r] - frames[s, j, r] * frames[s + 1, k, r]
        x[i] = 0.5 * stretch
        x[3 + i] = 0.5 * twist


@device_function
def _add_pull(frames, s, d, g, out, lean, turn):  # type: ignore[no-untyped-def]
    """Add the section's forces and moments, from the derivatives g (6,) by its strains.

    Fills lean (2, 3), sum_i g_i a_i and sum_i g_i b_i, and turn (3, 3), the sum of g p q^T / 2 over all
    products p . q in the strains w, p an axis of frame a and q one of frame b.
    """
    for r in range(3):
        lean[0, r] = g[0] * frames[s, 1, r] + g[1] * frames[s, 2, r] + g[2] * frames[s, 3, r]
        lean[1, r] = g[0] * frames[s + 1, 1, r] + g[1] * frames[s + 1, 2, r] + g[2] * frames[s + 1, 3, r]
        force = 0.5 * (lean[0, r] + lean[1, r])
        out[s, r] -= force
        out[s + 1, r] += force
        one = 0.5 * (g[5] * frames[s, 2, r] - g[4] * frames[s, 3, r])
        two = 0.5 * (g[3] * frames[s, 3, r] - g[5] * frames[s, 1, r])
        three = 0.5 * (g[4] * frames[s, 1, r] - g[3] * frames[s, 2, r])
        for c in range(3):
            turn[r, c] = one * frames[s + 1, 1, c] + two * frames[s + 1, 2, c] + three * frames[s + 1, 3, c]
    for r in range(3):
        i, k = (r + 1) % 3, (r + 2) % 3
        moment = turn[i, k] - turn[k, i]
        out[s, 3 + r] += 0.5 * (lean[0, i] * d[k] - lean[0, k] * d[i]) + moment
        out[s + 1, 3 + r] += 0.5 * (lean[1, i] * d[k] - lean[1, k] * d[i]) - moment


@device_function
def _strain_slopes(frames, s, d, jac):  # type: ignore[no-untyped-def]
    """Fill jac (6, 9), d strains / d (r_b, phi_a, phi_b); r_a has the opposite sign of r_b.

    Its last three rows are zero by r_b, and by phi_b the opposite of those by phi_a.
    """
    for i in range(3):
        j, k = (i + 1) % 3 + 1, (i + 2) % 3 + 1
        for r in range(3):
            m, n = (r + 1) % 3, (r + 2) % 3
            jac[i, r] = 0.5 * (frames[s, i + 1, r] + frames[s + 1, i + 1, r])
            jac[i, 3 + r] = 0.5 * (frames[s, i + 1, m] * d[n] - frames[s, i + 1, n] * d[m])
            jac[i, 6 + r] = 0.5 * (frames[s + 1, i + 1, m] * d[n] - frames[s + 1, i + 1, n] * d[m])
            jac[3 + i, 3 + r] = 0.5 * (
                frames[s, k, m] * frames[s + 1, j, n] - frames[s, k, n] * frames[s + 1, j, m]
                - frames[s, j, m] * frames[s + 1, k, n] + frames[s, j, n] * frames[s + 1, k, m]
            )  # fmt: skip


@device_function
def _turned(h, jac, out):  # type: ignore[no-untyped-def]
    """Fill out (6, 9), h jac."""
    for i in range(6):
        for k in range(3):
            bent = h[i, 3] * jac[3, 3 + k] + h[i, 4] * jac[4, 3 + k] + h[i, 5] * jac[5, 3 + k]
            out[i, k] = h[i, 0] * jac[0, k] + h[i, 1] * jac[1, k] + h[i, 2] * jac[2, k]
            out[i, 3 + k] = h[i, 0] * jac[0, 3 + k] + h[i, 1] * jac[1, 3 + k] + h[i, 2] * jac[2, 3 + k] + bent
            out[i, 6 + k] = h[i, 0] * jac[0, 6 + k] + h[i, 1] * jac[1, 6 + k] + h[i, 2] * jac[2, 6 + k] - bent


@device_function
def _product(a, b, row, i, k):  # type: ignore[no-untyped-def]
    """Return the product of columns i of a and k of b, over three rows from `row` on."""
    return a[row, i] * b[row, k] + a[row + 1, i] * b[row + 1, k] + a[row + 2, i] * b[row + 2, k]


@device_function
def _add_stiffness(jac, turned, s, diagonal, off):  # type: ignore[no-untyped-def]
    """Add jac^T turned to the blocks of the frames beside section s; the block between them is new."""
    b = s + 1
    for i in range(3):
        for k in range(3):
            # by r_b and r_b, phi_a, phi_b
            rr = _product(jac, turned, 0, i, k)
            ra = _product(jac, turned, 0, i, 3 + k)
            rb = _product(jac, turned, 0, i, 6 + k)
            diagonal[s, i, k] += rr
            diagonal[b, i, k] += rr
            off[b, i, k] = -rr
            diagonal[s, i, 3 + k] -= ra
            diagonal[s, 3 + k, i] -= ra
            off[b, i, 3 + k] = ra
            diagonal[b, i, 3 + k] += rb
            diagonal[b, 3 + k, i] += rb
            off[b, 3 + k, i] = -rb
    for i in range(3, 6):
        for k in range(3, 6):
            bent_a, bent_b = _product(jac, turned, 3, i, k), _product(jac, turned, 3, i, 3 + k)
            diagonal[s, i, k] += _product(jac, turned, 0, i, k) + bent_a
            off[b, k, i] = _product(jac, turned, 0, i, 3 + k) + bent_b
            diagonal[b, i, k] += _product(jac, turned, 0, 3 + i, 3 + k) - bent_b


@device_function
def _add_geometric(s, d, lean, turn, diagonal, off):  # type: ignore[no-untyped-def]
    """Add the strains' own second derivatives times the energy's gradient; turn is overwritten."""
    b = s + 1
    # r-phi parts: u_i moves by (phi x a_i) . dr / 2
    x, y, z = 0.5 * lean[0, 0], 0.5 * lean[0, 1], 0.5 * lean[0, 2]
    add_skew(diagonal, s, 0, 3, x, y, z)
    add_skew(diagonal, s, 3, 0, -x, -y, -z)
    add_skew(off, b, 0, 3, -x, -y, -z)
    x, y, z = 0.5 * lean[1, 0], 0.5 * lean[1, 1], 0.5 * lean[1, 2]
    add_skew(diagonal, b, 0, 3, -x, -y, -z)
    add_skew(diagonal, b, 3, 0, x, y, z)
    add_skew(off, b, 3, 0, -x, -y, -z)
    trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
    for r in range(3):
        for c in range(3):
            # rows phi_b, columns phi_a
            off[b, 3 + r, 3 + c] -= turn[r, c]
            turn[r, c] += 0.5 * d[r] * lean[0, c]
        off[b, 3 + r, 3 + r] += trace
    add_turning(diagonal, s, turn, 1.0)
    for r in range(3):
        for c in range(3):
            turn[r, c] += 0.5 * d[r] * (lean[1, c] - lean[0, c])
    add_turning(diagonal, b, turn, 1.0)


@device_function
def add_sections(frames, c, inverse_length, out, diagonal, off, hessian):  # type: ignore[no-untyped-def]
    """Add all sections; off is filled anew. Returns their energy."""
    d, x, g, h = (
        small_vector(3),
        small_vector(6),
        small_vector(6),
        small_matrix(6, 6) if hessian else small_matrix(0, 6),
    )
    lean, turn = small_matrix(2, 3), small_matrix(3, 3)
    jac, turned = small_matrix(6, 9), small_matrix(6, 9)
    energy = 0.0
    for s in range(c.shape[0]):
        section_strains(frames, s, d, x)
        place = x[2] * inverse_length[s] - 1.0
        if not (c[s, LOW] <= place <= c[s, HIGH] and x[3] * x[3] + x[4] * x[4] <= c[s, BENT]):
            return np.inf
        energy += section_energy(c, s, x, inverse_length[s], g, h)
        _add_pull(frames, s, d, g, out, lean, turn)
        if hessian:
            _strain_slopes(frames, s, d, jac)
            _turned(h, jac, turned)
            _add_stiffness(jac, turned, s, diagonal, off)
            _add_geometric(s, d, lean, turn, diagonal, off)
    return energy
