"""The film triangle nearest to each of some points, as a contact with features has it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.rigid.distance.film_distance import FeatureRows, FilmReach, FilmTriangles, TriangleLists, film_near


class Nearest(NamedTuple):
    """Which points are near enough, and the nearest point of the film.

    Fields: at what triangle and with which weights of its corners it is, how far from there the point is [m],
    negative behind the film, and the normal out of the film.
    """

    point: IntArray
    triangle: IntArray
    weight: Array
    distance: Array
    normal: Array


def nearest_film(
    points: Array, film: FilmTriangles, reach: FilmReach, held: IntArray | None = None
) -> Nearest:
    """Return for each point the film triangle nearest to it; `held` (k,) is the one that has held it back."""
    room, indices = len(points), np.zeros((2, len(points)), np.int64)
    held = np.full(room, -1) if held is None else held
    lists = TriangleLists.around(points, *film, max(reach.front_m, reach.depth_m))
    rows = FeatureRows(*indices, np.empty((room, 3)), np.empty((room, 4)))
    count = film_near(np.ascontiguousarray(points), film, lists, reach, held, rows)
    first = rows.point[:count], rows.triangle[:count], rows.weight[:count]
    return Nearest(*first, rows.found[:count, 0], rows.found[:count, 1:])
