"""Check whether films without modelled contact have passed through one another.

Checks are far apart in time, so they use no neighbour lists. The triangles that a point may be above or below
are found by boxes around each triangle, extended along its normal on both sides. Boxes that extend in all
directions, as in time steps, would find many times more in a mesh that is refined twice.
"""

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import IndexTable, Indices, Matrix
from cosim.base.kernels import kernel
from cosim.soft.body.body import SoftBody
from cosim.soft.body.places import describe_node
from cosim.soft.contact import self_contact_faces
from cosim.soft.contact.self_contact_candidates import BoxRows, FilmRows, fill_list, foot_beside
from cosim.soft.contact.self_contact_search import BEHIND_M, ShortList, add_ascending, fill_over
from cosim.soft.contact.triangle_side import measure_side
from cosim.soft.solve.branching import FilmOverlap

_OVERLAP_M: Final = 1e-4  # more than facets of neighbouring units overlap as drawn
_BEHIND_OTHER_M: Final = 20e-3  # less than the distance of the film behind


@kernel
def list_all(
    x: Matrix, triangles: IndexTable, place: Indices, first: Indices, listed: Indices, short: ShortList
) -> int:
    """Fill a short list with all pairs that boxes have found, and the sides of all triangles.

    Args:
        x: (n, 3) [m].
        triangles: (t, 3).
        place: (p,), index of each point in the order of the boxes.
        first: (p + 1,), see `fill_list`.
        listed: see `fill_list`.
        short: filled.

    Returns:
        Number of points with an entry.
    """
    count, points = 0, 0
    for t in range(triangles.shape[0]):
        measure_side(x, triangles[t], short.sides[t])
    for p in range(place.shape[0]):
        short.first[p] = count
        for entry in range(first[place[p]], first[place[p] + 1]):
            add_ascending(short, p, listed[entry], count)
            count += 1
        if count > short.first[p]:
            short.points[points], points = p, points + 1
    short.first[place.shape[0]] = count
    return points


@final
class OverlapCheck:
    """Checks whether the films of a body have passed through one another.

    Args:
        body: to check.
    """

    def __init__(self, body: SoftBody) -> None:
        self._body = body
        self._search = _BehindSearch(self_contact_faces.FilmFaces.of(body), body.positions, BEHIND_M)

    def overlap(self, positions: Array) -> FilmOverlap | None:
        """Return where films overlap by more than 0.1 mm; None if nowhere.

        Args:
            positions: (n, 3) [m].
        """
        deepest = self._search.deepest(positions)
        return deepest and FilmOverlap(deepest[0], describe_node(self._body, positions, deepest[1]))


@final
class ArmsOverlapCheck:
    """Checks whether films of two soft robots have passed through one another.

    Args:
        one: soft robot.
        other: soft robot.
    """

    def __init__(self, one: SoftBody, other: SoftBody) -> None:
        self._bodies = one, other
        faces = self_contact_faces.FilmFaces.apart(*map(self_contact_faces.FilmFaces.of, self._bodies))
        self._search = _BehindSearch(faces, np.concatenate((one.positions, other.positions)), _BEHIND_OTHER_M)

    def overlap(self, one: Array, other: Array) -> FilmOverlap | None:
        """Return where films of both overlap by more than 0.1 mm; None if nowhere.

        Args:
            one: (n, 3) [m], nodes of the one.
            other: (m, 3) [m], nodes of the other.
        """
        deepest = self._search.deepest(np.concatenate((one, other)))
        if deepest is None:
            return None
        depth, node = deepest
        place_text = describe_node(self._bodies[0], one, node) if node < len(one) else ""
        return FilmOverlap(depth, place_text or describe_node(self._bodies[1], other, node - len(one)))


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
        self._can_meet, self._behind_m, count = faces.can_meet, behind_m, len(points)
        self._rows = FilmRows.of(faces, points)
        self._boxes = BoxRows.of(self._rows, drawn)
        self._place = np.argsort(self._boxes.order)
        self._first, self._listed = np.zeros(count + 1, np.int64), np.empty(0, np.int64)
        self._short = ShortList.empty(count, len(faces.triangles))
        self._out = np.zeros((2 * count, 2), np.int64)

    def _behind(self, x: Array) -> int:
        """Fill rows (point, triangle) of points behind triangles; return their number."""
        rows, bounds = self._rows, (foot_beside(x, self._rows.triangles), self._behind_m)
        while (needed := fill_list(x, rows, self._boxes, bounds, self._first, self._listed)) > len(
            self._listed
        ):
            room = needed + needed // 2
            self._listed = np.empty(room, np.int64)
            self._short = self._short._replace(listed=np.empty(room, np.int64))
        points = list_all(x, rows.triangles, self._place, self._first, self._listed, self._short)
        bounds = 0.0, self._behind_m
        while (count := int(fill_over(x, rows, self._short, points, bounds, self._out))) > len(self._out):
            self._out = np.zeros((2 * count, 2), np.int64)
        return count

    def deepest(self, positions: Array) -> tuple[float, int] | None:
        """Return depth [m] and nearest node of the deepest point; None if none is 0.1 mm deep."""
        if not self._can_meet:
            return None
        count = self._behind(positions)
        if not count:
            return None
        rows, (point, triangle) = self._rows, self._out[:count].T
        a, b, c = np.moveaxis(positions[rows.triangles[triangle]], 1, 0)
        points = (rows.weights[point, :, None] * positions[rows.nodes[point]]).sum(axis=1)
        normal = np.cross(b - a, c - a)
        depth = ((a - points) * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)
        deepest = int(np.argmax(depth))
        if depth[deepest] < _OVERLAP_M:
            return None
        return float(depth[deepest]), int(rows.nodes[point[deepest], np.argmax(rows.weights[point[deepest]])])
