"""Bounds of the shapes of a scene as kernels see them."""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDICES, MATRIX


class ShapeBounds(NamedTuple):
    """Bounding boxes of g shapes, see `Shapes`; MuJoCo's arrays stay where they are in memory.

    Args:
        kind: (g,).
        center: (g, 3) [m], and
        half: (g, 3) [m], of the boxes in the shapes' own frames.
        geoms: (g,), places in MuJoCo's arrays.
        places: (geoms, 3) [m], and
        axes: (geoms, 9), world from geom, now.
        position: (g, 3) [m], and
        rotation: (g, 3, 3), where they are copied to.
        near: (g,), scratch.
    """

    kind: IntArray
    center: Array
    half: Array
    geoms: IntArray
    places: Array
    axes: Array
    position: Array
    rotation: Array
    near: IntArray


SHAPE_BOUNDS = types.NamedTuple(
    (INDICES, MATRIX, MATRIX, INDICES, MATRIX, MATRIX, MATRIX, BLOCKS, INDICES), ShapeBounds
)
