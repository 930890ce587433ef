"""Strains of the sections of a chain, and their energy, gradient and Hessian. For the section between frames
a and b, with d = r_b - r_a and axes a_i and b_i, u_i = (a_i + b_i) . d / 2 and w_1 = (a_3 . b_2 - a_2 . b_3)
/ 2, cyclic. Rigid motions do not change the strains, and reversing the chain only changes signs. Beyond the
limits of its samples a section's energy is infinite, so Newton's method takes a shorter step.
"""

import numpy as np

from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import device_function, small_matrix, small_vector
from cosim.reduced.sections.chain_arrays import ChainWork, LoadedChain, add_skew, add_turning
from cosim.reduced.sections.coefficients import BENT, HIGH, LOW
from cosim.reduced.sections.gap_energy import add_gaps
from cosim.reduced.sections.section_energy import section_energy


@device_function
def section_strains(frames: Blocks, s: int, d: Vector, x: Vector) -> None:
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
def _add_pull(
    frames: Blocks, s: int, d: Vector, g: Vector, out: Matrix, filled: tuple[Matrix, Matrix]
) -> None:
    """Add the section's forces and moments from the derivatives g (6,) of its energy by its strains.

    Fills lean (2, 3), sum_i g_i a_i and sum_i g_i b_i, and turn (3, 3), the sum of g p q^T / 2 over all
    products p . q in the strains w, p an axis of frame a and q one of frame b.
    """
    lean, turn = filled
    for r in range(3):
        lean[0, r] = g[0] * frames[s, 1, r] + g[1] * frames[s, 2, r] + g[2] * frames[s, 3, r]
        lean[1, r] = g[0] * frames[s + 1, 1, r] + g[1] * frames[s + 1, 2, r] + g[2] * frames[s + 1, 3, r]
        force = 0.5 * (lean[0, r] + lean[1, r])
        out[s, r] -= force
        out[s + 1, r] += force
        pull_1 = 0.5 * (g[5] * frames[s, 2, r] - g[4] * frames[s, 3, r])
        pull_2 = 0.5 * (g[3] * frames[s, 3, r] - g[5] * frames[s, 1, r])
        pull_3 = 0.5 * (g[4] * frames[s, 1, r] - g[3] * frames[s, 2, r])
        for c in range(3):
            turn[r, c] = (
                pull_1 * frames[s + 1, 1, c] + pull_2 * frames[s + 1, 2, c] + pull_3 * frames[s + 1, 3, c]
            )
    for r in range(3):
        i, k = (r + 1) % 3, (r + 2) % 3
        moment = turn[i, k] - turn[k, i]
        out[s, 3 + r] += 0.5 * (lean[0, i] * d[k] - lean[0, k] * d[i]) + moment
        out[s + 1, 3 + r] += 0.5 * (lean[1, i] * d[k] - lean[1, k] * d[i]) - moment


@device_function
def _product(a: Matrix, b: Matrix, row: int, i: int, k: int) -> float:
    """Return the product of columns i of a and k of b, over three rows from `row` on."""
    return a[row, i] * b[row, k] + a[row + 1, i] * b[row + 1, k] + a[row + 2, i] * b[row + 2, k]


@device_function
def _add_stiffness(frames: Blocks, s: int, d: Vector, h: Matrix, diagonal: Blocks, off: Blocks) -> None:
    """Add jac^T h jac to the diagonal blocks of the two frames of section s, and fill the block between them.

    jac (6, 9) is d strains / d (r_b, phi_a, phi_b); r_a has the opposite sign of r_b. Its last three rows
    are zero by r_b, and by phi_b the opposite of those by phi_a.
    """
    jac, h_jac = small_matrix(6, 9), small_matrix(6, 9)
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
    for i in range(6):
        for k in range(9):
            h_jac[i, k] = h[i, 0] * jac[0, k] + h[i, 1] * jac[1, k] + h[i, 2] * jac[2, k]
        for k in range(3):
            bent = h[i, 3] * jac[3, 3 + k] + h[i, 4] * jac[4, 3 + k] + h[i, 5] * jac[5, 3 + k]
            h_jac[i, 3 + k] += bent
            h_jac[i, 6 + k] -= bent
    b = s + 1
    for i in range(3):
        for k in range(3):
            # by r_b and r_b, phi_a, phi_b
            rr = _product(jac, h_jac, 0, i, k)
            ra = _product(jac, h_jac, 0, i, 3 + k)
            rb = _product(jac, h_jac, 0, i, 6 + k)
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
            bent_a, bent_b = _product(jac, h_jac, 3, i, k), _product(jac, h_jac, 3, i, 3 + k)
            diagonal[s, i, k] += _product(jac, h_jac, 0, i, k) + bent_a
            off[b, k, i] = _product(jac, h_jac, 0, i, 3 + k) + bent_b
            diagonal[b, i, k] += _product(jac, h_jac, 0, 3 + i, 3 + k) - bent_b


@device_function
def _add_geometric(s: int, d: Vector, lean: Matrix, turn: Matrix, diagonal: Blocks, off: Blocks) -> None:
    """Add the second derivatives of the strains times the energy's gradient; turn is overwritten."""
    b = s + 1
    # r-phi parts: u_i moves by (phi x a_i) . dr / 2
    x, y, z = 0.5 * lean[0, 0], 0.5 * lean[0, 1], 0.5 * lean[0, 2]
    add_skew(diagonal, s, (0, 3), x, y, z)
    add_skew(diagonal, s, (3, 0), -x, -y, -z)
    add_skew(off, b, (0, 3), -x, -y, -z)
    x, y, z = 0.5 * lean[1, 0], 0.5 * lean[1, 1], 0.5 * lean[1, 2]
    add_skew(diagonal, b, (0, 3), -x, -y, -z)
    add_skew(diagonal, b, (3, 0), x, y, z)
    add_skew(off, b, (3, 0), -x, -y, -z)
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
def add_sections(
    frames: Blocks, chain: LoadedChain, gradient: Matrix, work: ChainWork, hessian: bool
) -> float:
    """Add all sections, and fill the blocks between frames; return their energy, infinite out of range."""
    c, inverse_length = chain.coefficients, chain.inverse_length
    d, x, g = small_vector(3), small_vector(6), small_vector(6)
    h = small_matrix(6, 6) if hessian else small_matrix(0, 6)
    lean, turn = small_matrix(2, 3), small_matrix(3, 3)
    energy = 0.0
    for s in range(c.shape[0]):
        f = chain.near[s]
        section_strains(frames, f, d, x)
        stretch = x[2] * inverse_length[s] - 1.0
        if not (c[s, LOW] <= stretch <= c[s, HIGH] and x[3] * x[3] + x[4] * x[4] <= c[s, BENT]):
            return np.inf
        energy += section_energy(c, s, x, inverse_length[s], g, h)
        energy += add_gaps(c, s, x, chain.rims[s], g, h)
        _add_pull(frames, f, d, g, gradient, (lean, turn))
        if hessian:
            _add_stiffness(frames, f, d, h, work.diagonal, work.off)
            _add_geometric(f, d, lean, turn, work.diagonal, work.off)
    return energy
