"""A film as units and faces: its parts between folds, and which of them can meet outside the gas.

In the drawn shape an edge of the film may be a seam (angle through the gas below 108 degrees: two films
welded, or the edge of a box) or a valley (above 252 degrees: the hole ring between two units). Cut at the
valleys, the film falls into units; cut at the seams as well, into faces. A stack of ten units has twenty.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cosim.base.frames import IntArray, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.geometry.surface import dihedral_angle, interior_hinges, triangles_beside

_SEAM_RAD = 0.6 * np.pi  # away from right angles, which rounding would put on either side


class Relation(enum.IntEnum):
    """How two faces can meet."""

    NONE = 0
    """Of one unit, or of neighbours but turned away from each other."""
    VALLEY = 1
    """They share a valley: a point always belongs to the nearest triangle that faces it."""
    APART = 2
    """Of units that share nothing: a point belongs to a triangle only if no other film of it is nearer."""


@final
@dataclass(frozen=True)
class FilmFaces:
    """Units and faces of a film.

    Args:
        triangles: (m, 3).
        face: (m,) of each triangle.
        unit: (m,) of each triangle.
        unit_of_face: (faces,).
        relation: (faces, faces), `Relation`.
    """

    triangles: IntArray
    face: IntArray
    unit: IntArray
    unit_of_face: IntArray
    relation: IntArray

    @classmethod
    def of(cls, body: SoftBody) -> FilmFaces:
        """Return those of a body, by its drawn shape."""
        triangles = body.triangles
        hinges = interior_hinges(triangles)
        angle = dihedral_angle(body.positions, hinges)
        sides = triangles_beside(triangles, hinges)
        seam, valley = angle < _SEAM_RAD, angle > 2.0 * np.pi - _SEAM_RAD
        unit = _components(len(triangles), sides[~valley])
        face = _components(len(triangles), sides[~valley & ~seam])
        unit_of_face = np.zeros(int(face.max()) + 1, np.int64)
        unit_of_face[face] = unit
        return cls(triangles, face, unit, unit_of_face, _relations(unit_of_face, face[sides[valley]]))

    @property
    def units(self) -> int:
        """How many units."""
        return int(self.unit.max()) + 1

    @property
    def unit_nodes(self) -> list[IntArray]:
        """Nodes of each unit, ascending."""
        return [np.unique(self.triangles[self.unit == unit]) for unit in range(self.units)]

    @property
    def units_meet(self) -> Mask:
        """Which units (u, u) can meet."""
        meet = np.zeros((self.units, self.units), dtype=bool)
        a, b = np.nonzero(self.relation)
        meet[self.unit_of_face[a], self.unit_of_face[b]] = True
        return meet

    @property
    def can_meet(self) -> bool:
        """Whether any two faces can."""
        return bool(self.relation.any())


def _components(count: int, pairs: IntArray) -> IntArray:
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _relations(unit: IntArray, valleys: IntArray) -> IntArray:
    """Return how faces can meet, from the unit of each and the two faces (v, 2) at each valley."""
    neighbours = np.eye(int(unit.max()) + 1, dtype=bool)
    neighbours[unit[valleys[:, 0]], unit[valleys[:, 1]]] = True
    neighbours |= neighbours.T
    relation = np.where(neighbours[np.ix_(unit, unit)], Relation.NONE, Relation.APART)
    a, b = valleys[unit[valleys[:, 0]] != unit[valleys[:, 1]]].T
    relation[a, b] = relation[b, a] = Relation.VALLEY
    return np.ascontiguousarray(relation, dtype=np.int64)
