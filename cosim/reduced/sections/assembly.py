"""Assembles the gradient and tangent of a chain, and factorises the block-tridiagonal tangent (Cholesky).
With free frames f and the blocks A_f on the diagonal and B_f before them, L_f L_f^T = A_f + shift diag(scale)
- S_f S_f^T, S_f = B_f L_(f-1)^-T. The diagonals of L_f are stored as their reciprocals.
"""

import numpy as np

from cosim.base.kernel_types import Blocks, Flags, Matrix, Vector
from cosim.base.kernels import device_function, kernel, zero_vector
from cosim.reduced.sections.chain_arrays import ChainWork, InertiaTerm, LoadedChain
from cosim.reduced.sections.contact_terms import add_contacts
from cosim.reduced.sections.frame_terms import add_cables, add_frames
from cosim.reduced.sections.section_strains import add_sections


@device_function
def factorise(free: Flags, work: ChainWork, shift: float, scale: Vector) -> bool:
    """Fill low and side (f, 6, 6) with L and S; False where the free part is not positive definite."""
    low, side = work.low, work.side
    for f in range(free.shape[0]):
        if not free[f]:
            continue
        for i in range(6):
            for k in range(i + 1):
                low[f, i, k] = work.diagonal[f, i, k]
            low[f, i, i] += shift * scale[i]
        if f > 0 and free[f - 1]:
            for i in range(6):
                for k in range(6):
                    total = work.off[f, i, k]
                    for j in range(k):
                        total -= side[f, i, j] * low[f - 1, k, j]
                    side[f, i, k] = total * low[f - 1, k, k]
            for i in range(6):
                for k in range(i + 1):
                    total = low[f, i, k]
                    for j in range(6):
                        total -= side[f, i, j] * side[f, k, j]
                    low[f, i, k] = total
        for j in range(6):
            for i in range(j, 6):
                total = low[f, i, j]
                for k in range(j):
                    total -= low[f, i, k] * low[f, j, k]
                low[f, i, j] = total
            if not low[f, j, j] > 0.0:
                return False
            inverse = 1.0 / np.sqrt(low[f, j, j])
            low[f, j, j] = inverse
            for i in range(j + 1, 6):
                low[f, i, j] *= inverse
    return True


@device_function
def substitute(free: Flags, work: ChainWork, load: Matrix) -> None:
    """Solve with the factor for load (f, 6); the step (f, 6) is zero where a frame is held."""
    count, low, side, step = free.shape[0], work.low, work.side, work.step
    for f in range(count):
        for i in range(6):
            if not free[f]:
                step[f, i] = 0.0
                continue
            total = load[f, i]
            if f > 0 and free[f - 1]:
                for j in range(6):
                    total -= side[f, i, j] * step[f - 1, j]
            for j in range(i):
                total -= low[f, i, j] * step[f, j]
            step[f, i] = total * low[f, i, i]
    for f in range(count - 1, -1, -1):
        if not free[f]:
            continue
        for i in range(5, -1, -1):
            total = step[f, i]
            if f + 1 < count and free[f + 1]:
                for j in range(6):
                    total -= side[f + 1, j, i] * step[f + 1, j]
            for j in range(i + 1, 6):
                total -= low[f, j, i] * step[f, j]
            step[f, i] = total * low[f, i, i]


@kernel
def factorise_tangent(free: Flags, work: ChainWork) -> bool:
    """Make the factor of the tangent in the workspace; False where its free part is not positive definite."""
    return factorise(free, work, 0.0, zero_vector(6))


@kernel
def solve_tangent(free: Flags, work: ChainWork, load: Blocks, step: Blocks) -> None:
    """Solve with the factor for loads (k, f, 6); the steps (k, f, 6) are zero where a frame is held."""
    for k in range(load.shape[0]):
        substitute(free, work, load[k])
        for f in range(free.shape[0]):
            for i in range(6):
                step[k, f, i] = work.step[f, i]


@kernel
def assemble(
    frames: Blocks,
    chain: LoadedChain,
    inertia_term: InertiaTerm,
    gradient: Matrix,
    work: ChainWork,
    hessian: bool,
) -> float:
    """Fill the gradient (f, 6) and, with `hessian`, the Hessian's blocks; return the potential [J]."""
    energy = add_frames(frames, chain, inertia_term, gradient, work, hessian)
    energy += add_sections(frames, chain, gradient, work, hessian)
    energy += add_cables(frames, chain, gradient, work, hessian)
    return energy + add_contacts(frames, chain, gradient, work, hessian)
