"""Which triangles of a body are of which film: all of one, or each face group of its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.elements.material import Film
from cosim.soft.geometry.face_groups import check_face_groups


def by_film(
    triangles: IntArray,
    film: Film | Mapping[str, Film],
    groups: Mapping[str, IntArray],
    panel_m: Array | float,
) -> list[tuple[IntArray, Film, Array]]:
    """Return the triangles of each film, and the width of the panel of each.

    Args:
        triangles: (m, 3) node indices.
        film: material of all, or of each face group, in the order in which the triangles come.
        groups: places of triangles by name; others than those of `film` do not matter.
        panel_m: (m,) or one number.

    Raises:
        MeshError: a film's group is not there, or a triangle has no film or several.
    """
    panel = np.broadcast_to(panel_m, (len(triangles),))
    if isinstance(film, Film):
        return [(triangles, film, panel)]
    check_face_groups(groups, len(triangles))
    missing = [name for name in film if name not in groups]
    if missing:
        raise MeshError(f"a film is for face group {missing[0]!r}; there are {', '.join(groups) or 'none'}")
    films = np.bincount(
        np.concatenate([np.zeros(0, np.int64), *(groups[name] for name in film)]), minlength=len(triangles)
    )
    if (films != 1).any():
        wrong = int(np.flatnonzero(films != 1)[0])
        raise MeshError(
            f"triangle {wrong} belongs to {films[wrong]} of the face groups {', '.join(film) or '(none)'}, "
            "which have films; it must belong to one"
        )
    parts = [(groups[name], own) for name, own in film.items() if len(groups[name])]
    return [(triangles[places], own, panel[places]) for places, own in parts]
