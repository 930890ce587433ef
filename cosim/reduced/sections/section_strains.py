"""A chain of rigid frames: energy, gradient and Hessian of sections, frames, cables and contacts.

A frame is four points (4, 3): its origin r [m] and its three unit axes. Strains of the section between
frames a and b, d = r_b - r_a, axes a_i and b_i:
    u_i = (a_i + b_i) . d / 2,    w_1 = (a_3 . b_2 - a_2 . b_3) / 2  and so on in cyclic order;
rigid motions leave them alone, and turning the chain around only changes signs. A change (dr, phi) of a
frame moves r by dr and turns its axes by exp(S(phi)); all derivatives are exact for that:
    second order of f . exp(S(phi)) v:   phi^T [(f v^T + v f^T) / 2 - (f . v) 1] phi / 2.
Beyond the limits of its samples a section's energy is infinite: Newton's method then takes a shorter step.

Kernels get whole arrays and an index, not rows: a row is its own object, which costs more than what
is done with it.

What acts on the frames of a chain one by one, and cables between neighbours.

Masses, loads and cable eyelets are fixed to the frames: a point of local coordinates s is at r + sum s_i a_i.
Inertia of an implicit step is an elastic bed, as for nodes: c / 2 sum_ab M_ab (p_a - y_a) . (p_b - y_b).

Contact points on a chain of frames: energy, gradient and Hessian; see `chain_contact`.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import device_function, small_matrix, small_vector, zero_matrix
from cosim.reduced.sections.section_energy import BENT, HIGH, LOW, add_gaps, section_energy
from cosim.soft.contact.contact_law import touch


class LoadedChain(NamedTuple):
    """What a chain of f frames with s sections is at one pressure, and what acts on it.

    Args:
        coefficients: (s, c), of the sections' energies.
        inverse_length: (s,) [1/m].
        near: (s,) the frame before each section; the far one is the next.
        rims: (s, n, 2) [m], corners of square frames; (s, 0, 2) for others.
        mass: M (f, 4, 4), symmetric.
        load: (f, 4, 3) [N, N m], on the frames' points.
        far: (k,) frame at the far end of each cable segment; the near end is on the frame before.
        eyelets: (k, 2, 3) [m], in their frames.
        tension: (k,) [N].
        touching: (n,) the first of the two frames of each contact point.
        rows: (n, COLUMNS), of the contacts.
        widths: (2,) [m], smoothing and stick length of their law.
    """

    coefficients: Matrix
    inverse_length: Vector
    near: Indices
    rims: Blocks
    mass: Blocks
    load: Blocks
    far: Indices
    eyelets: Blocks
    tension: Vector
    touching: Indices
    rows: Matrix
    widths: Vector


class Bed(NamedTuple):
    """Inertia of an implicit step.

    Args:
        coefficient: c [1/s^2]; 0 in statics.
        target: y (f, 4, 3) [m].
    """

    coefficient: float
    target: Blocks


class ChainWork(NamedTuple):
    """A chain's tangent, in blocks of frames, and scratch of its solution.

    Args:
        diagonal: (f, 6, 6).
        off: (f, 6, 6), rows of frame f and columns of frame f - 1.
        low: (f, 6, 6), of the Cholesky factor, see `factorise`.
        side: (f, 6, 6), the same.
        trial: (f, 4, 3).
        target: (f, 4, 3), see `Bed`.
        step: (f, 6).
        along: (f, 4, 3), how fast points would go along with the flange in a step.
    """

    diagonal: Blocks
    off: Blocks
    low: Blocks
    side: Blocks
    trial: Blocks
    target: Blocks
    step: Matrix
    along: Blocks

    @classmethod
    def room(cls, frames: int) -> "ChainWork":
        """Return that of so many frames."""
        diagonal, off, low, side = np.zeros((4, frames, 6, 6))
        trial, target, along = np.zeros((3, frames, 4, 3))
        return cls(diagonal, off, low, side, trial, target, np.zeros((frames, 6)), along)


@device_function
def add_skew(block: Blocks, f: int, place: tuple[int, int], x: float, y: float, z: float) -> None:
    """Add S((x, y, z)) to a 3 x 3 part of block f that begins at a row and column."""
    row, column = place
    block[f, row, column + 1] -= z
    block[f, row, column + 2] += y
    block[f, row + 1, column] += z
    block[f, row + 1, column + 2] -= x
    block[f, row + 2, column] -= y
    block[f, row + 2, column + 1] += x


@device_function
def add_turning(block: Blocks, f: int, n: Matrix, factor: float) -> None:
    """Add factor [(n + n^T) / 2 - (trace n) 1] to the rotational part of block f, n (3, 3) a sum of f v^T."""
    trace = n[0, 0] + n[1, 1] + n[2, 2]
    for r in range(3):
        for c in range(3):
            block[f, 3 + r, 3 + c] += 0.5 * factor * (n[r, c] + n[c, r])
        block[f, 3 + r, 3 + r] -= factor * trace


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
    """Add the section's forces and moments, from the derivatives g (6,) by its strains.

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
def _product(a: Matrix, b: Matrix, row: int, i: int, k: int) -> float:
    """Return the product of columns i of a and k of b, over three rows from `row` on."""
    return a[row, i] * b[row, k] + a[row + 1, i] * b[row + 1, k] + a[row + 2, i] * b[row + 2, k]


@device_function
def _add_stiffness(frames: Blocks, s: int, d: Vector, h: Matrix, diagonal: Blocks, off: Blocks) -> None:
    """Add jac^T h jac to the blocks of the frames beside section s; the block between them is new.

    jac (6, 9) is d strains / d (r_b, phi_a, phi_b); r_a has the opposite sign of r_b. Its last three rows
    are zero by r_b, and by phi_b the opposite of those by phi_a.
    """
    jac, turned = small_matrix(6, 9), small_matrix(6, 9)
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
            turned[i, k] = h[i, 0] * jac[0, k] + h[i, 1] * jac[1, k] + h[i, 2] * jac[2, k]
        for k in range(3):
            bent = h[i, 3] * jac[3, 3 + k] + h[i, 4] * jac[4, 3 + k] + h[i, 5] * jac[5, 3 + k]
            turned[i, 3 + k] += bent
            turned[i, 6 + k] -= bent
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
def _add_geometric(s: int, d: Vector, lean: Matrix, turn: Matrix, diagonal: Blocks, off: Blocks) -> None:
    """Add the strains' own second derivatives times the energy's gradient; turn is overwritten."""
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
    """Add all sections; the blocks between frames are filled again. Returns their energy."""
    c, inverse_length = chain.coefficients, chain.inverse_length
    d, x, g = small_vector(3), small_vector(6), small_vector(6)
    h = small_matrix(6, 6) if hessian else small_matrix(0, 6)
    lean, turn = small_matrix(2, 3), small_matrix(3, 3)
    energy = 0.0
    for s in range(c.shape[0]):
        f = chain.near[s]
        section_strains(frames, f, d, x)
        place = x[2] * inverse_length[s] - 1.0
        if not (c[s, LOW] <= place <= c[s, HIGH] and x[3] * x[3] + x[4] * x[4] <= c[s, BENT]):
            return np.inf
        energy += section_energy(c, s, x, inverse_length[s], g, h)
        energy += add_gaps(c, s, x, chain.rims[s], g, h)
        _add_pull(frames, f, d, g, gradient, (lean, turn))
        if hessian:
            _add_stiffness(frames, f, d, h, work.diagonal, work.off)
            _add_geometric(f, d, lean, turn, work.diagonal, work.off)
    return energy


@device_function
def add_frames(
    frames: Blocks, chain: LoadedChain, bed: Bed, gradient: Matrix, work: ChainWork, hessian: bool
) -> float:
    """Fill gradient and diagonal blocks with dead loads and the inertial bed; return their energy."""
    load, mass, target = chain.load, chain.mass, bed.target
    force, turn, off = small_matrix(4, 3), small_matrix(3, 3), small_matrix(4, 3)
    energy = 0.0
    for f in range(frames.shape[0]):
        for a in range(4):
            for r in range(3):
                off[a, r] = frames[f, a, r] - target[f, a, r]
        for a in range(4):
            for r in range(3):
                pull = bed.coefficient * (
                    mass[f, a, 0] * off[0, r] + mass[f, a, 1] * off[1, r]
                    + mass[f, a, 2] * off[2, r] + mass[f, a, 3] * off[3, r]
                )  # fmt: skip
                energy += 0.5 * pull * off[a, r] - load[f, a, r] * frames[f, a, r]
                force[a, r] = pull - load[f, a, r]
        for r in range(3):
            for c in range(3):
                turn[r, c] = (
                    force[1, r] * frames[f, 1, c]
                    + force[2, r] * frames[f, 2, c]
                    + force[3, r] * frames[f, 3, c]
                )
        for r in range(3):
            i, k = (r + 1) % 3, (r + 2) % 3
            gradient[f, r] = force[0, r]
            gradient[f, 3 + r] = turn[k, i] - turn[i, k]
        if hessian:
            work.diagonal[f] = 0.0
            _add_bed(frames, f, bed.coefficient, mass, turn, work.diagonal)
    return energy


@device_function
def _add_bed(frames: Blocks, f: int, bed: float, mass: Blocks, turn: Matrix, diagonal: Blocks) -> None:
    """Add the second derivatives of dead loads and bed; turn (3, 3), sum of forces times axes."""
    add_turning(diagonal, f, turn, 1.0)
    if bed == 0.0:
        return
    for r in range(3):
        diagonal[f, r, r] += bed * mass[f, 0, 0]
    x, y, z = 0.0, 0.0, 0.0
    for a in range(1, 4):
        x += bed * mass[f, 0, a] * frames[f, a, 0]
        y += bed * mass[f, 0, a] * frames[f, a, 1]
        z += bed * mass[f, 0, a] * frames[f, a, 2]
    add_skew(diagonal, f, (0, 3), -x, -y, -z)
    add_skew(diagonal, f, (3, 0), x, y, z)
    # sum_ab M_ab [(a . b) 1 - b a^T]
    for r in range(3):
        for c in range(3):
            turn[r, c] = 0.0
    for a in range(1, 4):
        for r in range(3):
            value = bed * (
                mass[f, a, 1] * frames[f, 1, r]
                + mass[f, a, 2] * frames[f, 2, r]
                + mass[f, a, 3] * frames[f, 3, r]
            )
            for c in range(3):
                turn[r, c] += value * frames[f, a, c]
    add_turning(diagonal, f, turn, -1.0)


@device_function
def add_cables(frames: Blocks, chain: LoadedChain, out: Matrix, work: ChainWork, hessian: bool) -> float:
    """Add all cable segments under tension; return their energy."""
    far, eyelets, tension = chain.far, chain.eyelets, chain.tension
    arm, t = small_matrix(4, 3), small_vector(3)
    energy = 0.0
    for k in range(far.shape[0]):
        if tension[k] == 0.0:
            continue
        b, square = far[k], 0.0
        for r in range(3):
            for side in range(2):
                f = b - 1 + side
                arm[side, r] = (
                    eyelets[k, side, 0] * frames[f, 1, r] + eyelets[k, side, 1] * frames[f, 2, r]
                    + eyelets[k, side, 2] * frames[f, 3, r]
                )  # fmt: skip
            t[r] = frames[b, 0, r] + arm[1, r] - frames[b - 1, 0, r] - arm[0, r]
            square += t[r] * t[r]
        length = np.sqrt(square)
        for r in range(3):
            t[r] /= length
        for r in range(3):
            i, j = (r + 1) % 3, (r + 2) % 3
            out[b - 1, r] -= tension[k] * t[r]
            out[b, r] += tension[k] * t[r]
            out[b - 1, 3 + r] -= tension[k] * (arm[0, i] * t[j] - arm[0, j] * t[i])
            out[b, 3 + r] += tension[k] * (arm[1, i] * t[j] - arm[1, j] * t[i])
        if hessian:
            _add_across(b, arm, t, tension[k], length, work)
        energy += tension[k] * length
    return energy


@device_function
def _add_across(b: int, arm: Matrix, t: Vector, tension: float, length: float, work: ChainWork) -> None:
    """Add the stiffness of a segment across its direction t, and what turning its arms q adds.

    With w = tension / length and n = t x q: the step between the eyelets has w (1 - t t^T), its product
    with S(q) is w (S(q) - t n^T), and that of S(q')^T with it w ((q . q') 1 - q q'^T - n' n^T).
    """
    w, a, diagonal, off = tension / length, b - 1, work.diagonal, work.off
    for side in range(2):
        f, sign = a + side, -1.0 + 2.0 * side
        q0, q1, q2 = arm[side, 0], arm[side, 1], arm[side, 2]
        arm[2 + side, 0] = t[1] * q2 - t[2] * q1
        arm[2 + side, 1] = t[2] * q0 - t[0] * q2
        arm[2 + side, 2] = t[0] * q1 - t[1] * q0
        square, along = q0 * q0 + q1 * q1 + q2 * q2, t[0] * q0 + t[1] * q1 + t[2] * q2
        add_skew(diagonal, f, (0, 3), -w * q0, -w * q1, -w * q2)
        add_skew(diagonal, f, (3, 0), w * q0, w * q1, w * q2)
        for r in range(3):
            diagonal[f, r, r] += w
            diagonal[f, 3 + r, 3 + r] += w * square - sign * tension * along
            for c in range(3):
                mixed = w * t[r] * arm[2 + side, c]
                diagonal[f, r, c] -= w * t[r] * t[c]
                diagonal[f, r, 3 + c] += mixed
                diagonal[f, 3 + c, r] += mixed
                diagonal[f, 3 + r, 3 + c] += (
                    0.5 * sign * tension * (t[r] * arm[side, c] + arm[side, r] * t[c])
                    - w * (arm[side, r] * arm[side, c] + arm[2 + side, r] * arm[2 + side, c])
                )  # fmt: skip
    add_skew(off, b, (0, 3), w * arm[0, 0], w * arm[0, 1], w * arm[0, 2])
    add_skew(off, b, (3, 0), -w * arm[1, 0], -w * arm[1, 1], -w * arm[1, 2])
    inner = arm[0, 0] * arm[1, 0] + arm[0, 1] * arm[1, 1] + arm[0, 2] * arm[1, 2]
    for r in range(3):
        off[b, r, r] -= w
        off[b, 3 + r, 3 + r] -= w * inner
        for c in range(3):
            off[b, r, c] += w * t[r] * t[c]
            off[b, r, 3 + c] -= w * t[r] * arm[2, c]
            off[b, 3 + r, c] -= w * arm[3, r] * t[c]
            off[b, 3 + r, 3 + c] += w * (arm[0, r] * arm[1, c] + arm[3, r] * arm[2, c])


WEIGHTS, NORMAL, OFFSET, STIFFNESS, FRICTION, ANCHOR, COLUMNS = 0, 8, 11, 12, 13, 14, 17
"""Where a contact's row has what: weights of the points of two frames, and what is touched."""


@device_function
def add_contacts(frames: Blocks, chain: LoadedChain, out: Matrix, work: ChainWork, hessian: bool) -> float:
    """Add all contacts; return their energy."""
    first, rows, widths, energy = chain.touching, chain.rows, chain.widths, 0.0
    if first.shape[0] == 0:
        return energy
    point, own, tangent = small_vector(3), small_vector(3), small_matrix(3, 3)
    arm, jac, turned = small_matrix(2, 3), zero_matrix(3, 12), small_matrix(3, 12)
    for k in range(first.shape[0]):
        f = first[k]
        _place(frames, f, rows, k, arm, point)
        level, _, _ = touch(
            point, rows[k, NORMAL:OFFSET], rows[k, OFFSET], rows[k, STIFFNESS], rows[k, FRICTION],
            rows[k, ANCHOR:], widths, own, tangent,
        )  # fmt: skip
        if level == 0.0 and rows[k, FRICTION] == 0.0:
            continue
        energy += level
        for side in range(2):
            for r in range(3):
                i, j = (r + 1) % 3, (r + 2) % 3
                out[f + side, r] += rows[k, WEIGHTS + 4 * side] * own[r]
                out[f + side, 3 + r] += arm[side, i] * own[j] - arm[side, j] * own[i]
        if hessian:
            for side in range(2):  # d point / d (dr, phi) of both frames: [w 1, -S(q)]
                for r in range(3):
                    i, j = (r + 1) % 3, (r + 2) % 3
                    jac[r, 6 * side + r] = rows[k, WEIGHTS + 4 * side]
                    jac[r, 6 * side + 3 + i] = arm[side, j]
                    jac[r, 6 * side + 3 + j] = -arm[side, i]
            _stiffen(f, jac, tangent, turned, work)
            for side in range(2):  # the second order of the rotations
                for r in range(3):
                    for c in range(3):
                        tangent[r, c] = own[r] * arm[side, c]
                add_turning(work.diagonal, f + side, tangent, 1.0)
    return energy


@device_function
def _place(frames: Blocks, f: int, rows: Matrix, k: int, arm: Matrix, point: Vector) -> None:
    """Fill the contact point and its arms q (2, 3) from both origins, each by its weights."""
    for r in range(3):
        point[r] = 0.0
        for side in range(2):
            w = WEIGHTS + 4 * side
            arm[side, r] = (
                rows[k, w + 1] * frames[f + side, 1, r] + rows[k, w + 2] * frames[f + side, 2, r]
                + rows[k, w + 3] * frames[f + side, 3, r]
            )  # fmt: skip
            point[r] += rows[k, w] * frames[f + side, 0, r] + arm[side, r]


@device_function
def _stiffen(f: int, jac: Matrix, tangent: Matrix, turned: Matrix, work: ChainWork) -> None:
    """Add J^T K J to the blocks of frames f and f + 1."""
    diagonal, off = work.diagonal, work.off
    for k in range(12):
        for r in range(3):
            turned[r, k] = tangent[r, 0] * jac[0, k] + tangent[r, 1] * jac[1, k] + tangent[r, 2] * jac[2, k]
    for i in range(6):
        for k in range(6):
            for r in range(3):
                diagonal[f, i, k] += jac[r, i] * turned[r, k]
                diagonal[f + 1, i, k] += jac[r, 6 + i] * turned[r, 6 + k]
                off[f + 1, i, k] += jac[r, 6 + i] * turned[r, k]
