"""Arrays of a chain of rigid frames: sections, loads, and the blocks of its tangent. A frame
is four points (4, 3): its origin r [m] and its three unit axes a_i. A change (dr, phi) of a frame moves r by
dr and turns its axes by exp(S(phi)); all derivatives are exact for that, with the second order of f .
exp(S(phi)) v being phi^T [(f v^T + v f^T) / 2 - (f . v) 1] phi / 2. Kernels get whole arrays and an index,
because a row would be an object, which costs more than the computation.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import device_function


class LoadedChain(NamedTuple):
    """A chain of f frames with s sections at one pressure, and its loads.

    Args:
        coefficients: (s, c), of the sections' energies.
        inverse_length: (s,) [1/m].
        near: (s,) the frame before each section; the frame after it is the next one.
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


class InertiaTerm(NamedTuple):
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
        side: (f, 6, 6), blocks of the factor before the diagonal, see `factorise`.
        trial: (f, 4, 3).
        target: (f, 4, 3), see `InertiaTerm`.
        step: (f, 6).
        along: (f, 4, 3), velocities of points that move rigidly with the flange in a step.
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
        """Return the zeroed arrays for a number of frames."""
        diagonal, off, low, side = np.zeros((4, frames, 6, 6))
        trial, target, along = np.zeros((3, frames, 4, 3))
        return cls(diagonal, off, low, side, trial, target, np.zeros((frames, 6)), along)


@device_function
def add_skew(block: Blocks, f: int, corner: tuple[int, int], x: float, y: float, z: float) -> None:
    """Add S((x, y, z)) to a 3 x 3 part of block f that begins at a row and column."""
    row, column = corner
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
