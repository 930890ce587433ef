"""Contact points of a film for contact with itself: those of `contact_surface`, but each face has its own.

So a point on a seam or in a valley has the normal of one film, and touches what lies in front of that film.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.contact.self_contact_faces import FilmFaces
from cosim.soft.geometry.surface import triangle_area

_CORNER, _MIDPOINT, _CENTROID = 1.0 / 20.0, 2.0 / 15.0, 9.0 / 20.0  # as in `contact_surface`


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

    @cached_property
    def around(self) -> tuple[IntArray, IntArray]:
        """Where those of each point begin (p + 1,), and the triangles around the points, ascending."""
        order = np.argsort(self.on_triangle.ravel(), kind="stable")
        count = np.bincount(self.on_triangle.ravel(), minlength=len(self))
        return np.cumsum([0, *count], dtype=np.int64), order // self.on_triangle.shape[1]
