"""Dead loads, inertia and cables of a chain: energy, gradient and Hessian. Masses, loads and eyelets are
fixed to the frames: a point of local coordinates s is at r + sum s_i a_i. The inertia of an implicit step is
the energy c / 2 sum_ab M_ab (p_a - y_a) . (p_b - y_b), as for nodes.
"""

import numpy as np

from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import device_function, small_matrix, small_vector
from cosim.reduced.sections.chain_arrays import ChainWork, InertiaTerm, LoadedChain, add_skew, add_turning


@device_function
def add_frames(
    frames: Blocks,
    chain: LoadedChain,
    inertia_term: InertiaTerm,
    gradient: Matrix,
    work: ChainWork,
    hessian: bool,
) -> float:
    """Fill gradient and diagonal blocks with dead loads and the inertia term; return their energy [J]."""
    load, mass, target = chain.load, chain.mass, inertia_term.target
    force, turn, deviation = small_matrix(4, 3), small_matrix(3, 3), small_matrix(4, 3)
    energy = 0.0
    for f in range(frames.shape[0]):
        for a in range(4):
            for r in range(3):
                deviation[a, r] = frames[f, a, r] - target[f, a, r]
        for a in range(4):
            for r in range(3):
                pull = inertia_term.coefficient * (
                    mass[f, a, 0] * deviation[0, r] + mass[f, a, 1] * deviation[1, r]
                    + mass[f, a, 2] * deviation[2, r] + mass[f, a, 3] * deviation[3, r]
                )  # fmt: skip
                energy += 0.5 * pull * deviation[a, r] - load[f, a, r] * frames[f, a, r]
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
            _add_inertia(frames, f, inertia_term.coefficient, mass, turn, work.diagonal)
    return energy


@device_function
def _add_inertia(
    frames: Blocks, f: int, inertia_term: float, mass: Blocks, turn: Matrix, diagonal: Blocks
) -> None:
    """Add the second derivatives of dead loads and inertia; turn (3, 3) is the sum of forces times axes."""
    add_turning(diagonal, f, turn, 1.0)
    if inertia_term == 0.0:
        return
    for r in range(3):
        diagonal[f, r, r] += inertia_term * mass[f, 0, 0]
    x, y, z = 0.0, 0.0, 0.0
    for a in range(1, 4):
        x += inertia_term * mass[f, 0, a] * frames[f, a, 0]
        y += inertia_term * mass[f, 0, a] * frames[f, a, 1]
        z += inertia_term * mass[f, 0, a] * frames[f, a, 2]
    add_skew(diagonal, f, (0, 3), -x, -y, -z)
    add_skew(diagonal, f, (3, 0), x, y, z)
    # sum_ab M_ab [(a . b) 1 - b a^T]
    for r in range(3):
        for c in range(3):
            turn[r, c] = 0.0
    for a in range(1, 4):
        for r in range(3):
            value = inertia_term * (
                mass[f, a, 1] * frames[f, 1, r]
                + mass[f, a, 2] * frames[f, 2, r]
                + mass[f, a, 3] * frames[f, 3, r]
            )
            for c in range(3):
                turn[r, c] += value * frames[f, a, c]
    add_turning(diagonal, f, turn, -1.0)


@device_function
def add_cables(frames: Blocks, chain: LoadedChain, out: Matrix, work: ChainWork, hessian: bool) -> float:
    """Add all cable segments under tension; return their energy [J]."""
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
    """Add the geometric stiffness of a segment: across its direction t, and by the rotation of its arms q.

    With w = tension / length and n = t x q: the stiffness by the eyelets' distance is w (1 - t t^T), its
    product with S(q) is w (S(q) - t n^T), and that of S(q')^T with it w ((q . q') 1 - q q'^T - n' n^T).
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
