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
from cosim.soft.contact.triangle_side import measure_side
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
        measure_side(x, rows.triangles[t], lists.sides[t])
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
        self._body = body
        self._search = _BehindSearch(self_contact_faces.FilmFaces.of(body), body.positions, BEHIND_M)

    def overlap(self, positions: Array) -> FilmOverlap | None:
        """Return where films have passed through one another by more than 0.1 mm; None if nowhere.

        Args:
            positions: (n, 3) [m].
        """
        found = self._search.deepest(positions)
        return found and FilmOverlap(found[0], place_of(self._body, positions, found[1]))


@final
class ArmsLook:
    """Looks for films of two soft robots that have passed through one another.

    Args:
        one: soft robot.
        other: soft robot.
    """

    def __init__(self, one: SoftBody, other: SoftBody) -> None:
        self._bodies = one, other
        faces = self_contact_faces.FilmFaces.apart(*map(self_contact_faces.FilmFaces.of, self._bodies))
        self._search = _BehindSearch(faces, np.concatenate((one.positions, other.positions)), _BEHIND_OTHER_M)

    def overlap(self, one: Array, other: Array) -> FilmOverlap | None:
        """Return where films have passed through those of the other by more than 0.1 mm; None if nowhere.

        Args:
            one: (n, 3) [m], nodes of the one.
            other: (m, 3) [m], nodes of the other.
        """
        found = self._search.deepest(np.concatenate((one, other)))
        if found is None:
            return None
        depth, node = found
        place = place_of(self._bodies[0], one, node) if node < len(one) else ""
        return FilmOverlap(depth, place or place_of(self._bodies[1], other, node - len(one)))


_BEHIND_OTHER_M = 20e-3  # no film of a robot lies so near behind itself that this counts it wrongly


@final
class _BehindSearch:
    """Finds the deepest point of films behind others.

    Args:
        faces: of the films.
        drawn: (n, 3) [m], their nodes as drawn.
        behind_m: largest depth.
    """

    def __init__(self, faces: self_contact_faces.FilmFaces, drawn: Array, behind_m: float) -> None:
        points = self_contact_faces.FilmPoints.of(faces, drawn)
        self._can_meet, self._behind_m = faces.can_meet, behind_m
        self._lists = FilmLists.room(FilmRows.of(faces, points, drawn), faces.units_meet, len(drawn))
        self._out = np.zeros((2 * len(points), 2), np.int64)

    def deepest(self, positions: Array) -> tuple[float, int] | None:
        """Return depth [m] and nearest node of the deepest point; None where none is 0.1 mm deep."""
        if not self._can_meet:
            return None
        while (count := find_behind(positions, self._lists, self._behind_m, self._out)) < 0:
            self._lists = self._lists.with_room(-count)
        if count > len(self._out):
            self._out = np.zeros((2 * count, 2), np.int64)
            return self.deepest(positions)
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
        return float(depth[deepest]), int(rows.nodes[point[deepest], np.argmax(rows.weights[point[deepest]])])
