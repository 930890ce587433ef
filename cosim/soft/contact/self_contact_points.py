"""Contact points of a film for contact with itself: those of `contact_surface`, but each face has its own.

So a point on a seam or in a valley has the normal of one film, and touches what lies in front of that film.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import INDEX_TABLE, MATRIX, kernel
from cosim.soft.contact.self_contact_faces import FilmFaces
from cosim.soft.geometry.surface import triangle_area

_CORNER, _MIDPOINT, _CENTROID = 1.0 / 20.0, 2.0 / 15.0, 9.0 / 20.0  # as in `contact_surface`


@kernel((MATRIX, INDEX_TABLE, MATRIX, INDEX_TABLE, INDEX_TABLE, MATRIX, MATRIX, MATRIX))
def _outline(x, nodes, weights, triangles, points, place, outward, normals):  # type: ignore[no-untyped-def]
    """Fill place and outer normal (not of unit length) of each point, unit normal of each triangle."""
    outward[:] = 0.0
    for p in range(nodes.shape[0]):
        for r in range(3):
            place[p, r] = 0.0
            for a in range(3):
                place[p, r] += weights[p, a] * x[nodes[p, a], r]
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for r in range(3):
            s, q = (r + 1) % 3, (r + 2) % 3
            area = (x[b, s] - x[a, s]) * (x[c, q] - x[a, q]) - (x[b, q] - x[a, q]) * (x[c, s] - x[a, s])
            normals[t, r] = area
            for k in range(points.shape[1]):
                outward[points[t, k], r] += area
        size = np.sqrt(normals[t, 0] ** 2 + normals[t, 1] ** 2 + normals[t, 2] ** 2)
        for r in range(3):
            normals[t, r] /= size


@final
@dataclass(frozen=True)
class FilmPoints:
    """Contact points: nodes, then edge midpoints, then centroids.

    Args:
        nodes: (p, 3) that each point combines.
        weights: (p, 3).
        area: (p,) [m^2], share of the film's area.
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
    def of(cls, faces: FilmFaces, positions: Array) -> FilmPoints:
        """Return those of a film.

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
        found = [np.unique(row, axis=0, return_inverse=True) for row in rows]
        counts = [len(unique) for unique, _ in found]
        first = np.cumsum([0, *counts[:-1]])
        on_triangle = np.concatenate(
            [
                place.reshape(len(triangles), -1) + start
                for (_, place), start in zip(found, first, strict=True)
            ],
            axis=1,
        )
        points = np.concatenate([unique for unique, _ in found])
        weight = np.array([_CORNER] * 3 + [_MIDPOINT] * 3 + [_CENTROID])
        areas = triangle_area(positions, triangles)[:, None] * weight
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

    def outline(self, positions: Array) -> tuple[Array, Array, Array]:
        """Return places (p, 3) [m] and normals (p, 3) of the points, and unit normals (m, 3) of the film.

        All point out of the gas; those of the points are not of unit length.

        Args:
            positions: (n, 3) [m], of the nodes.
        """
        place, outward = np.empty((len(self), 3)), np.empty((len(self), 3))
        normals = np.empty((len(self.triangles), 3))
        _outline(
            positions, self.nodes, self.weights, self.triangles, self.on_triangle, place, outward, normals
        )
        return place, outward, normals
