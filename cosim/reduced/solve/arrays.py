"""A chain of frames and what acts on it, as one argument of a kernel that takes many steps."""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernels import INDICES, INTEGER, MATRIX, VECTOR
from cosim.reduced.sections.section_strains import CUBE, FLAGS


class ChainArrays(NamedTuple):
    """What the chain is; see `implicit_step`, and `SectionBody` for the tables over pressure.

    Args:
        call: address of the kernel of a step.
        free: (f,).
        offsets: (f, 4, 3).
        coefficients: (s, c).
        inverse_length: (s,).
        mass: (f, 4, 4).
        load: (f, 4, 3).
        far: (k,).
        eyelets: (k, 2, 3).
        touching: (0,), as nothing is touched.
        rows: (0, 17).
        widths: (2,).
        energies: (size, s c).
        lengths: (size, s).
        eyelet_table: (size, 6 k).
        target: (f, 4, 3), scratch.
        diagonal: (f, 6, 6), scratch.
        off: (f, 6, 6), scratch.
        low: (f, 6, 6), kept factor.
        side: (f, 6, 6), the same.
        bounds: (2,), see `minimise`.
    """

    call: int
    free: Mask
    offsets: Array
    coefficients: Array
    inverse_length: Array
    mass: Array
    load: Array
    far: IntArray
    eyelets: Array
    touching: IntArray
    rows: Array
    widths: Array
    energies: Array
    lengths: Array
    eyelet_table: Array
    target: Array
    diagonal: Array
    off: Array
    low: Array
    side: Array
    bounds: Array


CHAIN_ARRAYS = types.NamedTuple(
    (
        INTEGER, FLAGS, CUBE, MATRIX, VECTOR, CUBE, CUBE, INDICES, CUBE, INDICES, MATRIX, VECTOR, MATRIX,
        MATRIX, MATRIX, CUBE, CUBE, CUBE, CUBE, CUBE, VECTOR,
    ),
    ChainArrays,
)  # fmt: skip
