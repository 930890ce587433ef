"""Units and faces of a film, which of them can meet outside the gas, and their contact points.

In the drawn shape an edge of the film may be a seam (angle through the gas below 108 degrees: two welded
films, or the edge of a box) or a valley (above 252 degrees: the hole ring between two units). Cut at the
valleys, the film separates into units; cut at the seams as well, into faces. A stack of ten units has twenty.
Contact points are those of `contact_points`, but separate for each face, so that a point on a seam or in a
valley has the normal of one film, and touches only films in front of that.
"""

import enum
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.components import components
from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.body.body import SoftBody
from cosim.soft.geometry import surface

_SEAM_RAD = 0.6 * np.pi  # not a right angle, which rounding would put on either side
_CORNER, _MIDPOINT, _CENTROID = 1.0 / 20.0, 2.0 / 15.0, 9.0 / 20.0  # as in `contact_points`


class Relation(enum.IntEnum):
    """How two faces can meet."""

    NONE = 0
    """Of one unit, of neighbours that face away from each other, or far sides of two units of a stack."""
    VALLEY = 1
    """They share a valley: a point always belongs to the nearest triangle that faces it."""
    APART = 2
    """Of units without a common node: a point belongs to a triangle only if no film of its unit is nearer."""


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
    def of(cls, body: SoftBody) -> "FilmFaces":
        """Return the faces of a body, by its drawn shape."""
        triangles = body.triangles
        hinges = surface.interior_hinges(triangles)
        angle = surface.dihedral_angle(body.positions, hinges)
        sides = surface.triangles_beside(triangles, hinges)
        seam, valley = angle < _SEAM_RAD, angle > 2.0 * np.pi - _SEAM_RAD
        welded = _welded_flat(triangles)
        unit = components(len(triangles), np.concatenate([sides[~valley], welded]))
        face = components(len(triangles), np.concatenate([sides[~valley & ~seam], welded]))
        unit_of_face = np.zeros(int(face.max()) + 1, np.int64)
        unit_of_face[face] = unit
        return cls(triangles, face, unit, unit_of_face, _relations(unit_of_face, face[sides[valley]]))

    @classmethod
    def apart(cls, one: "FilmFaces", other: "FilmFaces") -> "FilmFaces":
        """Return the faces of two films that can meet each other, but not themselves."""
        nodes, faces, units = 1 + int(one.triangles.max()), len(one.unit_of_face), one.units
        is_of_first = np.arange(faces + len(other.unit_of_face)) < faces
        relation = np.where(is_of_first[:, None] != is_of_first[None, :], Relation.APART, Relation.NONE)
        return cls(
            np.concatenate((one.triangles, nodes + other.triangles)),
            np.concatenate((one.face, faces + other.face)),
            np.concatenate((one.unit, units + other.unit)),
            np.concatenate((one.unit_of_face, units + other.unit_of_face)),
            np.ascontiguousarray(relation, dtype=np.int64),
        )

    @property
    def units(self) -> int:
        """Number of units."""
        return int(self.unit.max()) + 1

    @property
    def unit_nodes(self) -> list[IntArray]:
        """Nodes of each unit, ascending."""
        return [np.unique(self.triangles[self.unit == unit]) for unit in range(self.units)]

    @property
    def seam_nodes(self) -> IntArray:
        """Nodes shared by two faces of a unit."""
        of_units = np.repeat(self.unit, 3), self.triangles.ravel(), np.repeat(self.face, 3)
        nodes = np.unique(np.stack(of_units, axis=1), axis=0)[:, :2]
        shared, count = np.unique(nodes, axis=0, return_counts=True)
        return np.unique(shared[count > 1, 1])

    @property
    def units_meet(self) -> Mask:
        """Which units (u, u) can meet."""
        meet = np.zeros((self.units, self.units), dtype=bool)
        a, b = np.nonzero(self.relation)
        meet[self.unit_of_face[a], self.unit_of_face[b]] = True
        return meet

    @property
    def can_meet(self) -> bool:
        """Whether any two faces can meet."""
        return bool(self.relation.any())

    @cached_property
    def inside_out(self) -> "FilmFaces":
        """The faces from inside: each is a unit, which can meet the other faces of its outside unit."""
        unit, faces = self.unit_of_face, np.arange(len(self.unit_of_face))
        meet = (unit[:, None] == unit[None, :]) & (faces[:, None] != faces[None, :])
        relation = np.where(meet, Relation.VALLEY, Relation.NONE).astype(np.int64)
        triangles = np.ascontiguousarray(self.triangles[:, ::-1])
        return FilmFaces(triangles, self.face, self.face, faces, np.ascontiguousarray(relation))


def _unique_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Return the unique rows (no negative entries) in ascending order, and the index of each row in them."""
    keys = np.ravel_multi_index(tuple(rows.T), tuple(rows.max(axis=0, initial=0) + 1))
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    return rows[first], index


def _welded_flat(triangles: IntArray) -> IntArray:
    """Return pairs (k, 2) that connect all triangles at edges of flat welds, which have four triangles."""
    _, edge, count = np.unique(
        np.sort(surface.directed_edges(triangles), axis=1), axis=0, return_inverse=True, return_counts=True
    )
    order = np.argsort(edge.ravel(), kind="stable")
    is_weld = (np.diff(edge.ravel()[order]) == 0) & (count[edge.ravel()[order[1:]]] > 2)
    return np.stack([order[:-1][is_weld], order[1:][is_weld]], axis=1) // 3


def _relations(unit: IntArray, valleys: IntArray) -> IntArray:
    """Return the relation of faces, from the unit of each face and the two faces (v, 2) at each valley."""
    from scipy.sparse.csgraph import shortest_path  # imported here because it takes long to load

    neighbours = np.eye(int(unit.max()) + 1, dtype=bool)
    neighbours[unit[valleys[:, 0]], unit[valleys[:, 1]]] = True
    neighbours |= neighbours.T
    a, b = valleys[unit[valleys[:, 0]] != unit[valleys[:, 1]]].T
    hops = shortest_path(neighbours & ~np.eye(len(neighbours), dtype=bool), unweighted=True)
    towards = np.zeros((len(unit), len(neighbours)), dtype=bool)
    for near_face, far_face in ((a, b), (b, a)):
        np.logical_or.at(towards, near_face, hops[unit[far_face]] < hops[unit[near_face]])
    # far sides of two units face each other through the units in between, as after a penetration
    faces_away = ~towards[:, unit]
    meet = ~neighbours[np.ix_(unit, unit)] & ~(
        faces_away & faces_away.T & np.isfinite(hops)[np.ix_(unit, unit)]
    )
    relation = np.where(meet, Relation.APART, Relation.NONE)
    relation[a, b] = relation[b, a] = Relation.VALLEY
    return np.ascontiguousarray(relation, dtype=np.int64)


@final
@dataclass(frozen=True)
class FilmPoints:
    """Contact points: nodes, then edge midpoints, then centroids.

    Args:
        nodes: (p, 3), nodes of each point's triangle.
        weights: (p, 3), barycentric.
        area: (p,) [m^2], tributary area.
        home: (p, 2) face and unit of each.
        triangles: (m, 3) of the film.
        on_triangle: (m, 7) contact points on each triangle.
    """

    nodes: IntArray
    weights: Array
    area: Array
    home: IntArray
    triangles: IntArray
    on_triangle: IntArray

    @classmethod
    def of(cls, faces: FilmFaces, positions: Array) -> "FilmPoints":
        """Return the contact points of a film.

        Args:
            faces: of the film.
            positions: (n, 3) [m], drawn; they give the areas.
        """
        triangles, face = faces.triangles, faces.face
        home = np.repeat(face[:, None], 3, axis=1)
        low, high = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)]), axis=0)
        rows = (
            np.stack([home, triangles, triangles, triangles], axis=2).reshape(-1, 4),
            np.stack([home, low, high, low], axis=2).reshape(-1, 4),
            np.column_stack([face, triangles]),
        )
        kinds = np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1.0 / 3.0] * 3])
        points_by_kind = [_unique_rows(row) for row in rows]
        counts = [len(unique) for unique, _ in points_by_kind]
        first = np.cumsum([0, *counts[:-1]])
        on_triangle = np.concatenate(
            [
                index.reshape(len(triangles), -1) + start
                for (_, index), start in zip(points_by_kind, first, strict=True)
            ],
            axis=1,
        )
        points = np.concatenate([unique for unique, _ in points_by_kind])
        weight = np.array([_CORNER] * 3 + [_MIDPOINT] * 3 + [_CENTROID])
        areas = surface.triangle_area(positions, triangles)[:, None] * weight
        return cls(
            nodes=np.ascontiguousarray(points[:, 1:]),
            weights=np.repeat(kinds, counts, axis=0),
            area=np.asarray(np.bincount(on_triangle.ravel(), areas.ravel(), len(points)), np.float64),
            home=np.column_stack([points[:, 0], faces.unit_of_face[points[:, 0]]]),
            triangles=triangles,
            on_triangle=np.ascontiguousarray(on_triangle),
        )

    def __len__(self) -> int:
        return len(self.nodes)

    @cached_property
    def around(self) -> tuple[IntArray, IntArray]:
        """Start (p + 1,) of each point's entries, and the triangles around the points, ascending."""
        order = np.argsort(self.on_triangle.ravel(), kind="stable")
        count = np.bincount(self.on_triangle.ravel(), minlength=len(self))
        return np.cumsum([0, *count], dtype=np.int64), order // self.on_triangle.shape[1]
