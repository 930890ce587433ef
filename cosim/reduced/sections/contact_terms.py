"""Contact points of a chain: energy, gradient and Hessian. A contact point is a combination of the points of
two frames.
"""

from cosim.base.kernel_types import Blocks, Matrix, Vector
from cosim.base.kernels import device_function, small_matrix, small_vector, zero_matrix
from cosim.reduced.sections.chain_arrays import ChainWork, LoadedChain, add_turning
from cosim.soft.contact.contact_law import touch

WEIGHTS, NORMAL, OFFSET, STIFFNESS, FRICTION, ANCHOR, COLUMNS = 0, 8, 11, 12, 13, 14, 17
"""Columns of a contact's row: weights of the points of two frames, and the touched plane with its law."""


@device_function
def add_contacts(frames: Blocks, chain: LoadedChain, out: Matrix, work: ChainWork, hessian: bool) -> float:
    """Add all contacts; return their energy [J]."""
    frame_before, rows, widths, energy = chain.touching, chain.rows, chain.widths, 0.0
    if frame_before.shape[0] == 0:
        return energy
    point, point_gradient, tangent = small_vector(3), small_vector(3), small_matrix(3, 3)
    arm, jac, stiff_jac = small_matrix(2, 3), zero_matrix(3, 12), small_matrix(3, 12)
    for k in range(frame_before.shape[0]):
        f = frame_before[k]
        _place(frames, f, rows, k, arm, point)
        level, _, _ = touch(
            point, rows[k, NORMAL:OFFSET], rows[k, OFFSET], rows[k, STIFFNESS], rows[k, FRICTION],
            rows[k, ANCHOR:], widths, point_gradient, tangent,
        )  # fmt: skip
        if level == 0.0 and rows[k, FRICTION] == 0.0:
            continue
        energy += level
        for side in range(2):
            for r in range(3):
                i, j = (r + 1) % 3, (r + 2) % 3
                out[f + side, r] += rows[k, WEIGHTS + 4 * side] * point_gradient[r]
                out[f + side, 3 + r] += arm[side, i] * point_gradient[j] - arm[side, j] * point_gradient[i]
        if hessian:
            for side in range(2):  # d point / d (dr, phi) of both frames: [w 1, -S(q)]
                for r in range(3):
                    i, j = (r + 1) % 3, (r + 2) % 3
                    jac[r, 6 * side + r] = rows[k, WEIGHTS + 4 * side]
                    jac[r, 6 * side + 3 + i] = arm[side, j]
                    jac[r, 6 * side + 3 + j] = -arm[side, i]
            _stiffen(f, jac, tangent, stiff_jac, work)
            for side in range(2):  # the second order of the rotations
                for r in range(3):
                    for c in range(3):
                        tangent[r, c] = point_gradient[r] * arm[side, c]
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
def _stiffen(f: int, jac: Matrix, tangent: Matrix, stiff_jac: Matrix, work: ChainWork) -> None:
    """Add J^T K J to the blocks of frames f and f + 1."""
    diagonal, off = work.diagonal, work.off
    for k in range(12):
        for r in range(3):
            stiff_jac[r, k] = (
                tangent[r, 0] * jac[0, k] + tangent[r, 1] * jac[1, k] + tangent[r, 2] * jac[2, k]
            )
    for i in range(6):
        for k in range(6):
            for r in range(3):
                diagonal[f, i, k] += jac[r, i] * stiff_jac[r, k]
                diagonal[f + 1, i, k] += jac[r, 6 + i] * stiff_jac[r, 6 + k]
                off[f + 1, i, k] += jac[r, 6 + i] * stiff_jac[r, k]
