"""Which points of a film may come over which triangles: lists that are valid until units have moved too far.

A point over a triangle by `self_contact_search` is the distance of its foot from it, room at most, and the
foot is no further from the triangle's bounding box than 2 b e, with e the longest edge and b the weight by
which a foot may lie beyond an edge. The long list is made for more room by a margin m; it holds all such
pairs while no two units have moved against each other by m / (1 + 4 b): point and foot, by the weights of
which b are negative, have come nearer by m at most. Units that are further from one another than room and
margin may move by that much more. Boxes around some points of a face, and around some triangles of another,
tell first which can be near.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.

Seen from one unit, turned and moved as its nodes have been in the mean, another may have gone a little way
though the film has been carried far: `rigid_motion`.

The short list is made of the long one, for a small motion. A foot within its triangle, of a point at a
distance d, was not far outside of it before point and corners had moved by m against each other: the
triangle's plane has turned by an angle whose sine is q = 2 m / (h - 2 m) at most, h its least height, and so

    M = (1 + 4 b) m + (|d| + (1 + 4 b) m) q / sqrt(1 - q^2)

in the plane, (1 + 4 b) m across; b is `BEYOND_EDGES`. Motions since both lists were made add up: of what the
long one allows a part is left to the short one, so that only that is looked at in most steps.
"""

from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Masks, Matrix, Vector
from cosim.base.kernels import allocating, copy_rows, device_function, kernel, small_matrix, small_vector
from cosim.soft.contact import contact_law, rigid_motion
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints, Relation
from cosim.soft.contact.triangle_side import least_weight, measure_side, over_plane, steepest_slope

BEYOND_EDGES: Final = 0.02
"""Barycentric weight by which a foot may lie outside of a triangle: none slips through between two."""
FEET_FOLLOW: Final = 1.0 + 4.0 * BEYOND_EDGES
"""How far a foot moves at most, in a triangle whose corners move by no more than 1."""
_FITTED = 24  # nodes to which a rigid motion is fitted, at least, if there are so many


class NearList(NamedTuple):
    """Triangles near points, and how long that serves.

    Args:
        first: (p + 1,), where the triangles of each point begin; of the long list in the order of its boxes.
        listed: these; in the short list ascending.
        before: (n, 3) [m], the nodes when the list was made.
        radius: (u,) [m], of each unit then.
        allowed: (u, u) [m], how far two units may have moved against each other since; symmetric.
        bounds: (2,) [m], distances in front of a triangle and behind it to which the list holds; negative
            before there is one.
    """

    first: Indices
    listed: Indices
    before: Matrix
    radius: Vector
    allowed: Matrix
    bounds: Vector


_MARGIN_M, _MARGIN_AT_REST_M = 4e-3, 0.5e-3
"""A larger margin makes the list longer, a smaller one ends it sooner. States at rest are often far apart."""
_POINTS_OF_BOX, _TRIANGLES_OF_BOX = 16, 16
VALLEY: Final = int(Relation.VALLEY)


class FilmRows(NamedTuple):
    """Points and triangles of a film, its units, and where boxes around some of them begin.

    Args:
        nodes: (p, 3) that each point combines.
        weights: (p, 3).
        homes: (p, 2) face and unit of each point.
        triangles: (t, 3).
        films: (t, 2), face and unit of each.
        spare: (p,) [m], added to the distances of each point: where films are drawn nearer than they press.
        relation: (faces, faces), see `Relation`.
        start: (p + 1,), where the triangles around each point begin.
        around: these.
        order: (p,) points, neighbours together.
        place: (p,) of each point in it.
        points_from: (a + 1,), where those of each box begin in it; they are of one face.
        triangle_order: (t,), the same of triangles.
        triangles_from: (c + 1,), where those of each box begin in it.
        unit_nodes: of all units.
        units_from: (u + 1,), where those of each begin.
    """

    nodes: IndexTable
    weights: Matrix
    homes: IndexTable
    triangles: IndexTable
    films: IndexTable
    spare: Vector
    relation: IndexTable
    start: Indices
    around: Indices
    order: Indices
    place: Indices
    points_from: Indices
    triangle_order: Indices
    triangles_from: Indices
    unit_nodes: Indices
    units_from: Indices

    @classmethod
    def of(cls, faces: FilmFaces, points: FilmPoints, positions: Array) -> "FilmRows":
        """Return those of a film, from its drawn nodes (n, 3) [m]."""
        films, units = np.column_stack([faces.face, faces.unit]), faces.unit_nodes
        places = (points.weights[:, :, None] * positions[points.nodes]).sum(axis=1)
        order = _neighbours(points.home[:, 0], places)
        triangle_order = _neighbours(faces.face, positions[faces.triangles].mean(axis=1))
        return cls(
            points.nodes, points.weights, points.home, faces.triangles, films, np.zeros(len(points)),
            faces.relation, *points.around, order, np.argsort(order),
            _runs(points.home[order, 0], _POINTS_OF_BOX), triangle_order,
            _runs(faces.face[triangle_order], _TRIANGLES_OF_BOX),
            np.concatenate(units), np.cumsum([0, *map(len, units)], dtype=np.int64),
        )  # fmt: skip


def _neighbours(face: IntArray, places: Array) -> IntArray:
    """Return the order of places (k, 3) of faces (k,), along a curve of Morton's in each face."""
    low = places.min(axis=0)
    cells = ((places - low) * (1023.0 / max(float(np.ptp(places, axis=0).max()), 1e-12))).astype(np.int64)
    bits = (cells[:, :, None] >> np.arange(10)) & 1
    return np.lexsort(((bits << (3 * np.arange(10) + np.arange(3)[:, None])).sum(axis=(1, 2)), face))


def _runs(face: IntArray, most: int) -> IntArray:
    """Return where runs of one face begin (k + 1,), none longer than `most`, and where the last one ends."""
    ends = [0, *(1 + np.flatnonzero(np.diff(face))).tolist(), len(face)]
    return np.array([*(k for a, b in pairwise(ends) for k in range(a, b, most)), len(face)], np.int64)


@device_function
def _enclose(boxes: Matrix, begin: int, end: int, around: Vector) -> None:
    """Fill the box (6,), smallest and largest coordinates, around some boxes."""
    for r in range(3):
        around[r], around[3 + r] = np.inf, -np.inf
        for k in range(begin, end):
            around[r], around[3 + r] = min(around[r], boxes[k, r]), max(around[3 + r], boxes[k, 3 + r])


@device_function
def _square_between(
    boxes: Matrix, k: int, x: float, y: float, z: float, u: float, v: float, w: float
) -> float:
    """Return the squared distance of box k from that between the corners (x, y, z) and (u, v, w)."""
    along = max(boxes[k, 0] - u, x - boxes[k, 3], 0.0)
    across = max(boxes[k, 1] - v, y - boxes[k, 4], 0.0)
    beyond = max(boxes[k, 2] - w, z - boxes[k, 5], 0.0)
    return along * along + across * across + beyond * beyond


@device_function
def _list_point(
    rows: FilmRows, p: int, near: tuple[Indices, Vector], limit: float, listed: Indices, total: int
) -> int:
    """Add the triangles of a point to the list; return how many entries there are then.

    Near are their numbers, doubled, and 1 more across a valley; and their squared distances.
    """
    triangles, squares = near
    for entry in range(triangles.shape[0]):
        t, lists = triangles[entry] >> 1, squares[entry] <= limit
        if lists and triangles[entry] & 1:  # there a point counts nothing that it hangs on
            for a in range(3):
                for b in range(3):
                    lists &= rows.nodes[p, a] != rows.triangles[t, b]
        if total < listed.shape[0]:
            listed[total] = t
        total += 1 if lists else 0
    return total


@device_function
def _find_near(
    rows: FilmRows, face: int, own: Vector, boxes: tuple[Matrix, Matrix], limit: float, near: Indices
) -> int:
    """Fill the places of triangles that points of a face can meet, in a box `own`; return how many."""
    triangles, bundles = boxes
    corners, found = (own[0], own[1], own[2], own[3], own[4], own[5]), 0
    for k in range(bundles.shape[0]):
        begin, end = rows.triangles_from[k], rows.triangles_from[k + 1]
        other = rows.films[rows.triangle_order[begin], 0]
        if rows.relation[face, other] != 0 and _square_between(bundles, k, *corners) <= limit:
            for place in range(begin, end):
                if _square_between(triangles, place, *corners) <= limit:
                    near[found] = place
                    found += 1
    return found


@device_function
def _fill_squares(columns: Matrix, count: int, point: Vector, squares: Vector) -> None:
    """Fill the squared distances of the first boxes from a point: in one loop without branches, for speed."""
    x, y, z = point[0], point[1], point[2]
    for e in range(count):
        along = max(columns[0, e] - x, x - columns[3, e], 0.0)
        across = max(columns[1, e] - y, y - columns[4, e], 0.0)
        beyond = max(columns[2, e] - z, z - columns[5, e], 0.0)
        squares[e] = along * along + across * across + beyond * beyond


@device_function
def _fill_box(x: Matrix, corners: Indices, above: float, box: Vector) -> None:
    """Fill the box (6,) around a triangle and what is above it, on both sides."""
    a, b, c, normal = corners[0], corners[1], corners[2], small_vector(3)
    if above > 0.0:
        contact_law.plane_of(x, corners, normal)
    for r in range(3):
        box[r], box[3 + r] = min(x[a, r], x[b, r], x[c, r]), max(x[a, r], x[b, r], x[c, r])
        further = above * abs(normal[r])
        if further > 0.0:  # of a triangle without an area it is not a number
            box[r], box[3 + r] = box[r] - further, box[3 + r] + further


@allocating
def fill_list(x: Matrix, rows: FilmRows, room: float, above: float, first: Indices, listed: Indices) -> int:
    """Fill each point's triangles; return how many there are.

    What is beyond the room of the list is only counted. Without any room the result is an upper bound.

    Args:
        x: (n, 3) [m].
        rows: of the film.
        room: how far a point may be from the box around a triangle [m].
        above: how far that box reaches on both sides of the triangle, beyond its edges not [m].
        first: (p + 1,), where those of each point begin, in the order of its boxes; filled.
        listed: filled.
    """
    points, triangles = np.empty((rows.nodes.shape[0], 6)), np.empty((rows.triangles.shape[0], 6))
    bundles, own = np.empty((rows.triangles_from.shape[0] - 1, 6)), np.empty(6)
    near, total, limit = np.empty(triangles.shape[0], np.int64), 0, room * room
    columns, squares = np.empty((6, triangles.shape[0])), np.empty(triangles.shape[0])
    for k in range(points.shape[0]):  # boxes of points have no size
        contact_law.fill_point(x, rows.nodes[rows.order[k]], rows.weights[rows.order[k]], points[k])
        for r in range(3):
            points[k, 3 + r] = points[k, r]
    for k in range(triangles.shape[0]):
        _fill_box(x, rows.triangles[rows.triangle_order[k]], above, triangles[k])
    for k in range(bundles.shape[0]):
        _enclose(triangles, rows.triangles_from[k], rows.triangles_from[k + 1], bundles[k])
    for box in range(rows.points_from.shape[0] - 1):
        begin, end = rows.points_from[box], rows.points_from[box + 1]
        _enclose(points, begin, end, own)
        face = rows.homes[rows.order[begin], 0]
        found = _find_near(rows, face, own, (triangles, bundles), limit, near)
        if listed.shape[0] == 0:
            total += found * (end - begin)
            continue
        for e in range(found):
            for r in range(6):
                columns[r, e] = triangles[near[e], r]
            t = rows.triangle_order[near[e]]
            near[e] = 2 * t + (rows.relation[face, rows.films[t, 0]] == VALLEY)
        for k in range(begin, end):
            first[k] = total
            _fill_squares(columns, found, points[k], squares)
            total = _list_point(rows, rows.order[k], (near[:found], squares), limit, listed, total)
    first[rows.nodes.shape[0]] = total
    return total


class FilmLists(NamedTuple):
    """Long list and short list, and what they are made with.

    Args:
        rows: of the film.
        meet: (u, u), which units can.
        long: made of the film.
        short: made of the long one.
        quiet: without entries: how long nothing of the short one is over a triangle, see `keep_quiet`.
        seen: (n, 3) [m], the nodes when that was last seen to hold.
        slack: (1,) [m], how much further two units might then have moved against each other.
        points: that have an entry in the short list.
        used: triangles that have one.
        counts: (2,), how many points and triangles these are.
        sides: (t, 13), see `measure_side`; scratch.
        lowest: (t, 6), see `_fill_plane` and `_fill_lowest`; scratch.
        moved: (u,) [m], deviation of each unit; scratch.
        went: (u, u) [m], how far two units have moved against each other, in the upper triangle; scratch.
        rigid: (u, 5, 3), mean now and before of each unit, and its rotation in between; scratch.
    """

    rows: FilmRows
    meet: Masks
    long: NearList
    short: NearList
    quiet: NearList
    seen: Matrix
    slack: Vector
    points: Indices
    used: Indices
    counts: Indices
    sides: Matrix
    lowest: Matrix
    moved: Vector
    went: Matrix
    rigid: Blocks

    @classmethod
    def room(cls, rows: FilmRows, meet: Mask, nodes: int) -> "FilmLists":
        """Return room for the lists of a film with so many nodes, in which there is nothing yet."""
        points, triangles, units = len(rows.nodes), len(rows.triangles), len(rows.units_from) - 1
        long, short, quiet = (
            NearList(
                np.zeros(points + 1, np.int64), np.empty(0, np.int64), np.empty((nodes, 3)),
                np.empty(units), np.empty((units, units)), np.full(2, -1.0),
            )
            for _ in range(3)
        )  # fmt: skip
        places = np.zeros(points, np.int64), np.zeros(triangles, np.int64), np.zeros(2, np.int64)
        scratch = np.empty((triangles, 13)), np.empty((triangles, 6)), np.empty(units)
        lists = long, short, quiet, np.empty((nodes, 3)), np.zeros(1)
        return cls(rows, meet, *lists, *places, *scratch, np.zeros((units, units)), np.empty((units, 5, 3)))

    def made(self, positions: Array, room_m: float, moves: bool) -> "FilmLists":
        """Return the lists with a new long one, with more room where that is too little.

        Args:
            positions: (n, 3) [m], of the nodes.
            room_m: largest distance of a point from a triangle that is asked for.
            moves: whether it is to serve the next steps as well.
        """
        if (needed := make_lists(positions, self, room_m, moves)) > len(self.long.listed):
            return self.with_room(needed).made(positions, room_m, moves)
        return self

    def with_room(self, needed: int) -> "FilmLists":
        """Return them with room for so many entries and some more, in which there is nothing yet."""
        long, short = (
            near._replace(listed=np.empty(needed + needed // 2, np.int64)) for near in (self.long, self.short)
        )
        return self._replace(long=long, short=short)


@device_function
def _fitted(start: Indices, unit: int) -> tuple[int, int, int]:
    """Return from which node of a unit on, up to which, and every how many a rigid motion is fitted to."""
    return start[unit], start[unit + 1], max(1, (start[unit + 1] - start[unit]) // _FITTED)


@device_function
def _keep(x: Matrix, rows: FilmRows, near: NearList) -> None:
    """Fill the nodes when a list is made, and the radius of each unit around the mean of what is fitted."""
    copy_rows(x, near.before)
    for unit in range(near.radius.shape[0]):
        begin, end, step = _fitted(rows.units_from, unit)
        share, u, v, w, most = 1.0 / len(range(begin, end, step)), 0.0, 0.0, 0.0, 0.0
        for k in range(begin, end, step):
            n = rows.unit_nodes[k]
            u, v, w = u + share * x[n, 0], v + share * x[n, 1], w + share * x[n, 2]
        for k in range(begin, end):
            n = rows.unit_nodes[k]
            most = max(most, (x[n, 0] - u) ** 2 + (x[n, 1] - v) ** 2 + (x[n, 2] - w) ** 2)
        near.radius[unit] = np.sqrt(most)


@device_function
def foot_beside(x: Matrix, triangles: IndexTable) -> float:
    """Return how far a foot on a triangle may be from the box around it."""
    longest = 0.0
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            u, v, w = x[a, 0] - x[b, 0], x[a, 1] - x[b, 1], x[a, 2] - x[b, 2]
            longest = max(longest, u * u + v * v + w * w)
    return 2.0 * BEYOND_EDGES * np.sqrt(longest)


@kernel(allocates=True)
def make_lists(x: Matrix, lists: FilmLists, room_m: float, moves: bool) -> int:
    """Make a new long list; return how many entries it has, where that is no more than there is room for.

    Args:
        x: (n, 3) [m].
        lists: filled.
        room_m: largest distance of a point from a triangle that is asked for [m].
        moves: whether it is to serve the next steps as well.
    """
    rows, long, short = lists.rows, lists.long, lists.short
    margin = _MARGIN_M if moves else _MARGIN_AT_REST_M
    room = room_m + margin + foot_beside(x, rows.triangles)
    needed = fill_list(x, rows, room, 0.0, long.first, long.listed)
    for near in (long, short, lists.quiet):
        near.bounds[0], near.bounds[1] = -1.0, -1.0
    if needed > long.listed.shape[0]:
        return needed
    boxes, least = np.empty((rows.units_from.shape[0] - 1, 6)), margin / FEET_FOLLOW - _MOTION_M
    for unit in range(boxes.shape[0]):
        low, high = boxes[unit], boxes[unit, 3:]
        low[:3], high[:] = np.inf, -np.inf
        for k in range(rows.units_from[unit], rows.units_from[unit + 1]):
            for r in range(3):
                value = x[rows.unit_nodes[k], r]
                low[r], high[r] = min(low[r], value), max(high[r], value)
    for a in range(boxes.shape[0]):
        for b in range(boxes.shape[0]):
            low, high = boxes[b], boxes[b, 3:]
            square = _square_between(boxes, a, low[0], low[1], low[2], high[0], high[1], high[2])
            further = max(np.sqrt(square) - room, 0.0) if lists.meet[a, b] else np.inf
            allowed = (margin + further) / FEET_FOLLOW
            # where the long list has pairs, it leaves a little to the short one, far from there half
            short.allowed[a, b] = min(0.5 * allowed, allowed - least)
            long.allowed[a, b] = max(0.5 * allowed, least)
    _keep(x, rows, long)
    long.bounds[0], long.bounds[1] = room_m, room_m
    return needed


_MOTION_M: Final = 0.3e-3  # a larger one makes the short list longer, a smaller one ends it sooner
_FURTHER_M: Final = 0.1e-3  # for which the short list looks ahead beyond what is asked for


@device_function
def _fill_plane(x: Matrix, corners: Indices, lowest: Vector) -> None:
    """Fill a triangle's plane: normal, and its distance from the origin."""
    normal = lowest[:3]
    contact_law.plane_of(x, corners, normal)
    lowest[3] = 0.0
    for r in range(3):
        lowest[3] += normal[r] * x[corners[0], r]


@device_function
def _fill_lowest(side: Vector, lowest: Vector) -> None:
    """Fill by what weight a foot may be outside of a triangle and come into it in a small motion.

    First of a point at no distance, then what is added over distance [1/m]. A narrow triangle may turn far.
    """
    across, steepest = FEET_FOLLOW * _MOTION_M, steepest_slope(side)
    sine = 2.0 * _MOTION_M * steepest / (1.0 - 2.0 * _MOTION_M * steepest)
    lowest[4], lowest[5] = -np.inf, 0.0
    if 0.0 <= sine < 1.0:
        lowest[5] = -steepest * sine / np.sqrt(1.0 - sine * sine)
        lowest[4] = -BEYOND_EDGES - across * steepest + across * lowest[5]


@device_function
def add_ascending(near: NearList, p: int, t: int, at: int) -> None:
    """Add a triangle to those of a point, the last one so far, in a list that ends at `at`."""
    while at > near.first[p] and near.listed[at - 1] > t:
        near.listed[at] = near.listed[at - 1]
        at -= 1
    near.listed[at] = t


_SEEN, _LISTED = 1, 2  # of a triangle: measured, in the short list


@device_function
def _shorten(x: Matrix, lists: FilmLists, reach: float, behind: float) -> None:
    """Fill the short list with what may come within reach in front of a triangle, or behind it."""
    rows, long, short, sides, count = lists.rows, lists.long, lists.short, lists.sides, 0
    across, place, lowest, points = FEET_FOLLOW * _MOTION_M, small_vector(3), lists.lowest, 0
    furthest = max(reach, behind) + across
    for t in range(sides.shape[0]):
        _fill_plane(x, rows.triangles[t], lowest[t])
        lists.used[t] = 0
    for p in range(rows.nodes.shape[0]):
        short.first[p], begin, end = count, long.first[rows.place[p]], long.first[rows.place[p] + 1]
        if begin == end:
            continue
        contact_law.fill_point(x, rows.nodes[p], rows.weights[p], place)
        px, py, pz = place[0], place[1], place[2]
        for entry in range(begin, end):
            t = long.listed[entry]
            d = lowest[t, 0] * px + lowest[t, 1] * py + lowest[t, 2] * pz - lowest[t, 3]
            if not -behind - across <= d <= furthest:  # which most are too far from
                continue
            if d > reach + across and rows.relation[rows.homes[p, 0], rows.films[t, 0]] == VALLEY:
                continue
            if lists.used[t] == 0:
                lists.used[t] = _SEEN
                measure_side(x, rows.triangles[t], sides[t])
                _fill_lowest(sides[t], lowest[t])
            if least_weight(sides[t], px, py, pz) >= lowest[t, 4] + lowest[t, 5] * abs(d):
                lists.used[t] = _LISTED
                add_ascending(short, p, t, count)
                count += 1
        if count > short.first[p]:
            lists.points[points], points = p, points + 1
    short.first[rows.nodes.shape[0]], lists.counts[0], lists.counts[1] = count, points, 0
    for t in range(sides.shape[0]):
        if lists.used[t] == _LISTED:
            lists.used[lists.counts[1]] = t
            lists.counts[1] += 1
    lists.went[:] = 0.0
    short.bounds[0], short.bounds[1] = reach, behind
    _keep(x, rows, short)


@device_function
def units_stay(x: Matrix, lists: FilmLists, near: NearList, less: float) -> bool:
    """Return whether no two units have moved against each other by more than a list allows, less a bit.

    The motion of two is what a node of the one has gone at most and one of the other, together, besides a
    rigid motion of both: that of the one. A bound of it, of how rigid motions differ, tells most pairs.
    """
    nodes, start, before, moved = lists.rows.unit_nodes, lists.rows.units_from, near.before, lists.moved
    minors, rigid = small_matrix(3, 3), lists.rigid
    units = start.shape[0] - 1
    for a in range(units):
        rigid_motion.fit_motion(x, before, nodes, _fitted(start, a), rigid[a], minors)
        moved[a] = rigid_motion.deviation(x, before, nodes, start[a], start[a + 1], rigid[a])
    for a in range(units):
        fits = False
        for b in range(a + 1, units):
            allowed = near.allowed[a, b] - less
            if allowed == np.inf:
                continue
            went = moved[a] + moved[b] + rigid_motion.rigid_difference(rigid[a], rigid[b], near.radius[b])
            if not went <= allowed:
                if not fits:
                    rigid_motion.fit_motion(x, before, nodes, (start[a], start[a + 1], 1), rigid[a], minors)
                    moved[a] = rigid_motion.deviation(x, before, nodes, start[a], start[a + 1], rigid[a])
                    fits = True
                went = moved[a] + rigid_motion.deviation(x, before, nodes, start[b], start[b + 1], rigid[a])
            if not went <= allowed:
                return False
            lists.went[a, b] = went
    return True


@device_function
def stays_quiet(x: Matrix, lists: FilmLists, reach: float, behind: float) -> bool:
    """Return whether still nothing of the film is over a triangle, as `keep_quiet` has it.

    Most often no node has gone far since that was last seen, besides a rigid motion of all: two units have
    moved by no more than twice as much against each other.

    Args:
        x: (n, 3) [m].
        lists: filled.
        reach: largest distance in front of a triangle that is asked for [m].
        behind: the same behind it [m].
    """
    quiet, nodes, slack, rigid = lists.quiet, lists.rows.unit_nodes, np.inf, lists.rigid[0]
    if not (reach <= quiet.bounds[0] and behind <= quiet.bounds[1]):
        return False
    some = 0, nodes.shape[0], max(1, nodes.shape[0] // _FITTED)
    rigid_motion.fit_motion(x, lists.seen, nodes, some, rigid, small_matrix(3, 3))
    if 2.0 * rigid_motion.deviation(x, lists.seen, nodes, 0, nodes.shape[0], rigid) <= lists.slack[0]:
        return True
    if not units_stay(x, lists, quiet, 0.0):
        return False
    for a in range(lists.went.shape[0]):
        for b in range(a + 1, lists.went.shape[0]):
            slack = min(slack, quiet.allowed[a, b] - lists.went[a, b])
    copy_rows(x, lists.seen)
    lists.slack[0] = slack
    return True


@device_function
def lists_serve(x: Matrix, lists: FilmLists, reach: float, behind: float) -> bool:
    """Return whether the short list holds all that may be over a triangle, if need be made of the long one.

    Fills the sides of its triangles.

    Args:
        x: (n, 3) [m].
        lists: filled.
        reach: largest distance in front of a triangle that is asked for [m].
        behind: the same behind it [m].
    """
    rows, long, short, further = lists.rows, lists.long, lists.short, reach + _FURTHER_M
    within = reach <= short.bounds[0] and behind <= short.bounds[1]
    if within and units_stay(x, lists, short, 0.0):
        for k in range(lists.counts[1]):
            t = lists.used[k]
            measure_side(x, rows.triangles[t], lists.sides[t])
        return True
    # pairs of units of which the long list has none may come nearer by what is asked for beyond its room
    less = max(max(further, behind) - long.bounds[0], 0.0) / FEET_FOLLOW
    if long.bounds[0] < 0.0 or not units_stay(x, lists, long, less):
        return False
    _shorten(x, lists, further, behind)
    return True


@device_function
def keep_quiet(x: Matrix, lists: FilmLists, reach: float, behind: float) -> None:
    """Fill for how small a motion [m] nothing comes over a triangle, of a short list in which nothing is now.

    By a point's distance, or by how far its foot is beside the triangle: with s the steepest slope, M s in a
    motion m is at most m s (1.36 + 2.6 s |d|) as long as m s is no more than 1/10.

    Args:
        x: (n, 3) [m], for which the lists are valid.
        lists: filled.
        reach: largest distance in front of a triangle [m].
        behind: the same behind it [m].
    """
    rows, short, quiet, place = lists.rows, lists.short, lists.quiet, small_vector(3)
    for a in range(lists.went.shape[0]):
        for b in range(lists.went.shape[0]):
            quiet.allowed[a, b] = short.allowed[a, b] - lists.went[min(a, b), max(a, b)]
    for k in range(lists.counts[0]):
        p = lists.points[k]
        contact_law.fill_point(x, rows.nodes[p], rows.weights[p], place)
        for entry in range(short.first[p], short.first[p + 1]):
            t = short.listed[entry]
            a, b = min(rows.homes[p, 1], rows.films[t, 1]), max(rows.homes[p, 1], rows.films[t, 1])
            d = over_plane(lists.sides[t], place[0], place[1], place[2])
            ahead = d + rows.spare[p] - reach
            if quiet.allowed[a, b] * FEET_FOLLOW > ahead:
                weight = least_weight(lists.sides[t], place[0], place[1], place[2])
                steepest = steepest_slope(lists.sides[t])
                beside = min((-BEYOND_EDGES - weight) / (1.36 + 2.6 * steepest * abs(d)), 0.1) / steepest
                free = max(max(ahead, -behind - d) / FEET_FOLLOW, beside)
                quiet.allowed[a, b] = min(quiet.allowed[a, b], max(free, 0.0))
    quiet.bounds[0], quiet.bounds[1], lists.slack[0] = reach, behind, -1.0
    _keep(x, rows, quiet)
