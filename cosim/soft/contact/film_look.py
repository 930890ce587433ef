"""Looks at whether films whose contact is not modelled have passed through one another.

A look knows of nothing before it: shapes are far apart. Which triangles a point is above, it finds by boxes
around these and what is above them, on both sides. By boxes around all that is as near in any direction, as
steps find it, a mesh refined twice would have many times as many. A file of its own: runs that model contact
of films do not compile its kernel, others only that.
"""

from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import IndexTable, Matrix
from cosim.base.kernels import kernel
from cosim.soft.body.body import SoftBody
from cosim.soft.body.places import place_of
from cosim.soft.contact import self_contact_candidates, self_contact_faces
from cosim.soft.contact.self_contact_candidates import FilmLists, FilmRows
from cosim.soft.contact.self_contact_search import BEHIND_M, fill_over
from cosim.soft.solve.branching import FilmOverlap


@kernel(allocates=True)
def find_behind(x: Matrix, lists: FilmLists, behind: float, out: IndexTable) -> int:
    """Fill rows (point, triangle) of what lies behind what, as `find_over` does, from this shape alone.

    Args:
        x: (n, 3) [m].
        lists: whose room is used; what they held is lost.
        behind: largest distance [m].
        out: (k, 2), filled.

    Returns:
        How many rows that takes, none of which are written beyond the room; if the lists have too little
        room, the negative of what they need.
    """
    rows, long, short, count, points = lists.rows, lists.long, lists.short, 0, 0
    beside = self_contact_candidates.foot_beside(x, rows.triangles)
    needed = self_contact_candidates.fill_list(x, rows, beside, behind, long.first, long.listed)
    if needed > long.listed.shape[0]:
        return -needed
    for t in range(lists.sides.shape[0]):
        self_contact_candidates.measure_side(x, rows.triangles[t], lists.sides[t])
    for p in range(rows.nodes.shape[0]):
        short.first[p], place = count, rows.place[p]
        for entry in range(long.first[place], long.first[place + 1]):
            self_contact_candidates.add_ascending(short, p, long.listed[entry], count)
            count += 1
        if count > short.first[p]:
            lists.points[points], points = p, points + 1
    short.first[rows.nodes.shape[0]], lists.counts[0] = count, points
    return fill_over(x, lists, 0.0, behind, out)


_OVERLAP_M = 1e-4  # beyond what the facets of neighbouring units share as drawn


@final
class FilmLook:
    """Looks for films that have passed through one another.

    Args:
        body: of which films.
    """

    def __init__(self, body: SoftBody) -> None:
        faces = self_contact_faces.FilmFaces.of(body)
        points = self_contact_faces.FilmPoints.of(faces, body.positions)
        self._body, self._can_meet = body, faces.can_meet
        self._lists = FilmLists.room(FilmRows.of(faces, points, body.positions), faces.units_meet, body.nodes)
        self._out = np.zeros((2 * len(points), 2), np.int64)

    def overlap(self, positions: Array) -> FilmOverlap | None:
        """Return where films have passed through one another by more than 0.1 mm; None if nowhere.

        Args:
            positions: (n, 3) [m].
        """
        if not self._can_meet:
            return None
        while (count := find_behind(positions, self._lists, BEHIND_M, self._out)) < 0:
            self._lists = self._lists.with_room(-count)
        if count > len(self._out):
            self._out = np.zeros((2 * count, 2), np.int64)
            return self.overlap(positions)
        if not count:
            return None
        rows, (point, triangle) = self._lists.rows, self._out[:count].T
        a, b, c = np.moveaxis(positions[rows.triangles[triangle]], 1, 0)
        place = (rows.weights[point, :, None] * positions[rows.nodes[point]]).sum(axis=1)
        normal = np.cross(b - a, c - a)
        depth = ((a - place) * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)
        deepest = int(np.argmax(depth))
        if depth[deepest] < _OVERLAP_M:
            return None
        node = rows.nodes[point[deepest], np.argmax(rows.weights[point[deepest]])]
        return FilmOverlap(float(depth[deepest]), place_of(self._body, positions, int(node)))
