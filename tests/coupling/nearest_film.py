"""The film triangle nearest to each of some points, as a contact with features has it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.rigid.distance.film_distance import FeatureRows, FilmReach, FilmTriangles, TriangleLists, film_near


class Nearest(NamedTuple):
    """Which points are near enough, at what triangle, and how far from it [m], negative behind the film."""

    point: IntArray
    triangle: IntArray
    distance: Array


def nearest_film(points: Array, film: FilmTriangles, reach: FilmReach) -> Nearest:
    """Return for each point the film triangle nearest to it, where it is near enough; nothing was held."""
    room, indices = len(points), np.zeros((2, len(points)), np.int64)
    lists = TriangleLists.around(points, *film, max(reach.front_m, reach.depth_m))
    rows = FeatureRows(*indices, np.empty((room, 3)), np.empty((room, 4)))
    count = film_near(np.ascontiguousarray(points), film, lists, reach, np.full(room, -1), rows)
    return Nearest(rows.point[:count], rows.triangle[:count], rows.found[:count, 0])
