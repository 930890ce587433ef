"""What triangles of a surface carry: groups and values with names, which a part has from the whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.surface import triangles_beside

_Rows = TypeVar("_Rows", Array, IntArray)


def check_face_groups(groups: Mapping[str, IntArray], triangles: int) -> None:
    """Check that face groups hold triangles that exist, each once.

    Args:
        groups: places of triangles by name.
        triangles: how many there are.

    Raises:
        MeshError: they do not.
    """
    for name, places in groups.items():
        if places.size and (places.min() < 0 or places.max() >= triangles):
            bad = int(places.min() if places.min() < 0 else places.max())
            raise MeshError(f"face group {name} has triangle {bad}; 0 to {triangles - 1} exist")
        if len(np.unique(places)) < len(places):
            raise MeshError(f"face group {name} has a triangle twice")


def check_face_values(values: Mapping[str, Array], triangles: int) -> None:
    """Check that there is a finite value, or row of values, for every triangle.

    Raises:
        MeshError: there is not.
    """
    for name, rows in values.items():
        if len(rows) != triangles or not np.isfinite(rows).all():
            raise MeshError(
                f"face values {name} have shape {rows.shape}; {triangles} rows of finite numbers are needed"
            )


def parts_of_groups(groups: Mapping[str, IntArray], parent: IntArray) -> dict[str, IntArray]:
    """Return the face groups of parts of triangles, ascending.

    Args:
        groups: places of the whole triangles by name.
        parent: (parts,) the triangle that each is part of.
    """
    return {name: np.flatnonzero(np.isin(parent, places)) for name, places in groups.items()}


def mean_beside(triangles: IntArray, hinges: IntArray, values: Array) -> Array:
    """Return the harmonic mean (h,) of the values of both triangles at each hinge: both bend by one moment.

    Args:
        triangles: (m, 3) node indices.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
        values: (m,) of each triangle, not negative.
    """
    first, second = values[triangles_beside(triangles, hinges)].T
    # equal values are their mean to the last bit
    ratio = np.divide(2.0 * second, first + second, out=np.zeros(len(hinges)), where=first + second > 0.0)
    return np.asarray(first * ratio)


def rows_of(parts: Sequence[_Rows]) -> _Rows:
    """Return one array of several, row after row; the array itself where there is but one."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
