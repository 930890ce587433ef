"""Lists of points of a film and triangles that they may come over, valid until units have moved too far.

The long list is made for more room by a margin m; it holds all such pairs while no two units have moved
against each other by m / (1 + 4 b), b as in `self_contact_candidates`: point and foot, by the weights of
which b are negative, have come nearer by m at most. Units that are further from one another than room and
margin may move by that much more. Seen from one unit, turned and moved as its nodes have been in the mean,
another may have gone a little way though the film has been carried far: `rigid_motion`.

The short list is made of the long one, for a small motion. A foot within its triangle, of a point at a
distance d, was not far outside of it before point and corners had moved by m against each other: the
triangle's plane has turned by an angle whose sine is q = 2 m / (h - 2 m) at most, h its least height, and so

    M = (1 + 4 b) m + (|d| + (1 + 4 b) m) q / sqrt(1 - q^2)

in the plane, (1 + 4 b) m across; b is `BEYOND_EDGES`. Motions since both lists were made add up: of what the
long one allows a part is left to the short one, so that only that is looked at in most steps.
Source: the neighbour list of Verlet, Computer "Experiments" on Classical Fluids, Phys. Rev. 159 (1967) 98.
"""

from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Indices, Masks, Matrix, Vector
from cosim.base.kernels import (
    copy_rows,
    device_function,
    kernel,
    small_matrix,
    small_vector,
    unchecked,
    zero_matrix,
)
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import rigid_motion, triangle_foot
from cosim.soft.contact.self_contact_candidates import (
    BEYOND_EDGES,
    VALLEY,
    BoxRows,
    FilmRows,
    fill_list,
    foot_beside,
    square_between,
)
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints
from cosim.soft.contact.self_contact_search import ShortList, add_ascending, fill_over, measure_sides
from cosim.soft.contact.triangle_side import least_weight, measure_side, over_plane, steepest_slope

FEET_FOLLOW: Final = 1.0 + 4.0 * BEYOND_EDGES
"""How far a foot moves at most, in a triangle whose corners move by no more than 1."""
_FITTED = 24  # nodes to which a rigid motion is fitted, at least, if there are so many
_MARGIN_M, _MARGIN_AT_REST_M = 4e-3, 0.5e-3
"""A larger margin makes the list longer, a smaller one ends it sooner. States at rest are often far apart."""
_MOTION_M: Final = 0.3e-3  # a larger one makes the short list longer, a smaller one ends it sooner
_FURTHER_M: Final = 0.1e-3  # added to the distance for which a short list is made
_TOO_FAR_M: Final = 1e-3  # a short list that reaches so much further than is asked for is made again
_SEEN, _LISTED = 1, 2  # of a triangle: measured, in the short list


class Units(NamedTuple):
    """Nodes of a film's units, and how units move.

    Args:
        nodes: of all units.
        start: (u + 1,), where those of each begin.
        moved: (u,) [m], deviation of each unit from its rigid motion; scratch.
        went: (u, u) [m], how far two units have moved against each other, in the upper triangle.
        rigid: (u, 5, 3), mean now and before of each unit, and its rotation in between; scratch.
    """

    nodes: Indices
    start: Indices
    moved: Vector
    went: Matrix
    rigid: Blocks


class Allowance(NamedTuple):
    """How far units may move until something that was found no longer holds.

    Args:
        before: (n, 3) [m], the nodes when it was found.
        radius: (u,) [m], of each unit then.
        allowed: (u, u) [m], how far two units may have moved against each other since; symmetric.
    """

    before: Matrix
    radius: Vector
    allowed: Matrix

    @classmethod
    def room(cls, nodes: int, units: int) -> "Allowance":
        """Return room for that of so many nodes and units."""
        return cls(np.zeros((nodes, 3)), np.empty(units), np.empty((units, units)))


@device_function
def _fitted(start: Indices, unit: int) -> tuple[int, int, int]:
    """Return from which node of a unit on, up to which, and every how many a rigid motion is fitted to."""
    return start[unit], start[unit + 1], max(1, (start[unit + 1] - start[unit]) // _FITTED)


@kernel
def keep_shape(x: Matrix, units: Units, allowance: Allowance) -> None:
    """Fill the nodes when something is found, and the radius of each unit around the mean of what is fitted.

    Args:
        x: (n, 3) [m].
        units: of the film.
        allowance: filled, but for what it allows.
    """
    copy_rows(x, allowance.before)
    for unit in range(allowance.radius.shape[0]):
        begin, end, step = _fitted(units.start, unit)
        share, u, v, w, most = 1.0 / len(range(begin, end, step)), 0.0, 0.0, 0.0, 0.0
        for k in range(begin, end, step):
            n = units.nodes[k]
            u, v, w = u + share * x[n, 0], v + share * x[n, 1], w + share * x[n, 2]
        for k in range(begin, end):
            n = units.nodes[k]
            most = max(most, (x[n, 0] - u) ** 2 + (x[n, 1] - v) ** 2 + (x[n, 2] - w) ** 2)
        allowance.radius[unit] = np.sqrt(most)


@kernel(allocates=True)
def allow_motion(
    x: Matrix, units: Units, meet: Masks, margins: tuple[float, float], long: Matrix, short: Matrix
) -> None:
    """Fill how far units may move while a list is valid.

    Args:
        x: (n, 3) [m].
        units: of the film.
        meet: (u, u), which units can.
        margins: room of the long list, and the part of it that is left to motion [m].
        long: (u, u) [m], of the long list, and
        short: (u, u) [m], of the short one, which is left the rest; filled.
    """
    room, margin = margins
    boxes, least = np.empty((units.start.shape[0] - 1, 6)), margin / FEET_FOLLOW - _MOTION_M
    for unit in range(boxes.shape[0]):
        low, high = boxes[unit], boxes[unit, 3:]
        low[:3], high[:] = np.inf, -np.inf
        for k in range(units.start[unit], units.start[unit + 1]):
            for r in range(3):
                value = x[units.nodes[k], r]
                low[r], high[r] = min(low[r], value), max(high[r], value)
    for a in range(boxes.shape[0]):
        for b in range(boxes.shape[0]):
            low, high = boxes[b], boxes[b, 3:]
            square = square_between(boxes, a, low[0], low[1], low[2], high[0], high[1], high[2])
            further = max(np.sqrt(square) - room, 0.0) if meet[a, b] else np.inf
            allowed = (margin + further) / FEET_FOLLOW
            # where the long list has pairs, it leaves a little to the short one, far from there half
            short[a, b] = min(0.5 * allowed, allowed - least)
            long[a, b] = max(0.5 * allowed, least)


@kernel
def units_stay(x: Matrix, units: Units, allowance: Allowance, less: float) -> bool:
    """Return whether no two units have moved against each other by more than is allowed, less a bit.

    The motion of two is what a node of the one has gone at most and one of the other, together, besides a
    rigid motion of both: that of the one. A bound of it, of how rigid motions differ, tells most pairs.

    Args:
        x: (n, 3) [m].
        units: of the film; how far they went is filled.
        allowance: that may hold.
        less: a bit [m].
    """
    nodes, start, before, moved = units.nodes, units.start, allowance.before, units.moved
    minors, rigid = small_matrix(3, 3), units.rigid
    count = start.shape[0] - 1
    for a in range(count):
        rigid_motion.fit_motion(x, before, nodes, _fitted(start, a), rigid[a], minors)
        moved[a] = rigid_motion.deviation(x, before, nodes, start[a], start[a + 1], rigid[a])
    for a in range(count):
        fits = False
        for b in range(a + 1, count):
            allowed = allowance.allowed[a, b] - less
            if allowed == np.inf:
                continue
            apart = rigid_motion.rigid_difference(rigid[a], rigid[b], allowance.radius[b])
            went = moved[a] + moved[b] + apart
            if not went <= allowed:
                if not fits:
                    rigid_motion.fit_motion(x, before, nodes, (start[a], start[a + 1], 1), rigid[a], minors)
                    moved[a] = rigid_motion.deviation(x, before, nodes, start[a], start[a + 1], rigid[a])
                    fits = True
                went = moved[a] + rigid_motion.deviation(x, before, nodes, start[b], start[b + 1], rigid[a])
            if not went <= allowed:
                return False
            units.went[a, b] = went
    return True


@kernel
def furthest_gone(x: Matrix, before: Matrix, nodes: Indices) -> float:
    """Return how far [m] one of some nodes has gone at most besides a rigid motion of all.

    Args:
        x: (n, 3) [m], now.
        before: (n, 3) [m].
        nodes: of them.
    """
    rigid, count = zero_matrix(5, 3), nodes.shape[0]
    some = 0, count, max(1, count // _FITTED)
    rigid_motion.fit_motion(x, before, nodes, some, rigid, small_matrix(3, 3))
    return rigid_motion.deviation(x, before, nodes, 0, count, rigid)


@kernel
def least_left(allowed: Matrix, went: Matrix) -> float:
    """Return how much further [m] two units may move at least, of those in the upper triangle."""
    least = np.inf
    for a in range(went.shape[0]):
        for b in range(a + 1, went.shape[0]):
            least = min(least, allowed[a, b] - went[a, b])
    return least


@device_function
def _fill_plane(x: Matrix, corners: Indices, lowest: Vector) -> None:
    """Fill a triangle's plane: normal, and its distance from the origin."""
    normal = lowest[:3]
    triangle_foot.plane_of(x, corners, normal)
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


class LongList(NamedTuple):
    """Triangles near points, by boxes.

    Args:
        first: (p + 1,), where the triangles of each point begin, in the order of its boxes.
        listed: these.
        place: (p,) of each point in that order.
        lowest: (t, 6), see `_fill_plane` and `_fill_lowest`; scratch.
    """

    first: Indices
    listed: Indices
    place: Indices
    lowest: Matrix


@kernel
def shorten_list(
    x: Matrix, rows: FilmRows, long: LongList, reach: float, behind: float, short: ShortList
) -> tuple[int, int]:
    """Fill the short list with what may come within reach in front of a triangle, or behind it.

    Args:
        x: (n, 3) [m].
        rows: of the film.
        long: list that is valid.
        reach: largest distance in front of a triangle [m].
        behind: the same behind it [m].
        short: filled, with the sides of its triangles.

    Returns:
        How many points and how many triangles have an entry.
    """
    sides, count = short.sides, 0
    across, place, lowest, points = FEET_FOLLOW * _MOTION_M, small_vector(3), long.lowest, 0
    furthest = max(reach, behind) + across
    for t in range(sides.shape[0]):
        _fill_plane(x, rows.triangles[t], lowest[t])
        short.used[t] = 0
    for p in range(rows.nodes.shape[0]):
        short.first[p], begin, end = count, long.first[long.place[p]], long.first[long.place[p] + 1]
        nearest = np.inf
        if begin == end:
            continue
        triangle_foot.fill_point(x, rows.nodes[p], rows.weights[p], place)
        px, py, pz = place[0], place[1], place[2]
        for entry in range(begin, end):
            t = long.listed[entry]
            d = lowest[t, 0] * px + lowest[t, 1] * py + lowest[t, 2] * pz - lowest[t, 3]
            if not -behind - across <= d <= furthest:  # which most are too far from
                continue
            if d > reach + across and rows.relation[rows.homes[p, 0], rows.films[t, 0]] == VALLEY:
                continue
            if short.used[t] == 0:
                short.used[t] = _SEEN
                measure_side(x, rows.triangles[t], sides[t])
                _fill_lowest(sides[t], lowest[t])
            if least_weight(sides[t], px, py, pz) >= lowest[t, 4] + lowest[t, 5] * abs(d):
                add_ascending(short, p, t, count)
                count, nearest = count + 1, min(nearest, d)
        if nearest > reach + across:  # triangles further in front count only where one is nearer or behind
            count = short.first[p]
        if count > short.first[p]:
            short.points[points], points = p, points + 1
        for entry in range(short.first[p], count):
            short.used[short.listed[entry]] = _LISTED
    short.first[rows.nodes.shape[0]], used = count, 0
    for t in range(sides.shape[0]):
        if short.used[t] == _LISTED:
            short.used[used] = t
            used += 1
    return points, used


@kernel
def fill_quiet(
    x: Matrix, rows: FilmRows, short: ShortList, points: int, bounds: tuple[float, float], quiet: Matrix
) -> None:
    """Lower how small a motion [m] brings nothing over a triangle, of a short list in which nothing is now.

    By a point's distance, or by how far its foot is beside the triangle: with s the steepest slope, M s in a
    motion m is at most m s (1.36 + 2.6 s |d|) as long as m s is no more than 1/10.

    Args:
        x: (n, 3) [m], for which the list is valid.
        rows: of the film.
        short: list.
        points: how many have an entry.
        bounds: largest distance in front of a triangle, and behind it [m].
        quiet: (u, u) [m], lowered.
    """
    place, (reach, behind) = small_vector(3), bounds
    for k in range(points):
        p = short.points[k]
        triangle_foot.fill_point(x, rows.nodes[p], rows.weights[p], place)
        for entry in range(short.first[p], short.first[p + 1]):
            t = short.listed[entry]
            a, b = min(rows.homes[p, 1], rows.films[t, 1]), max(rows.homes[p, 1], rows.films[t, 1])
            d = over_plane(short.sides[t], place[0], place[1], place[2])
            ahead = d + rows.spare[p] - reach
            if quiet[a, b] * FEET_FOLLOW > ahead:
                weight = least_weight(short.sides[t], place[0], place[1], place[2])
                steepest = steepest_slope(short.sides[t])
                beside = min((-BEYOND_EDGES - weight) / (1.36 + 2.6 * steepest * abs(d)), 0.1) / steepest
                free = max(max(ahead, -behind - d) / FEET_FOLLOW, beside)
                quiet[a, b] = min(quiet[a, b], max(free, 0.0))


@final
class FilmLists:
    """Finds which points of a film lie over which of its triangles, by lists that are made when needed.

    Args:
        faces: of the film.
        points: of the film.
        body: its drawn nodes say which points are neighbours.
    """

    def __init__(self, faces: FilmFaces, points: FilmPoints, body: SoftBody) -> None:
        self.rows = FilmRows.of(faces, points)
        self.boxes = BoxRows.of(self.rows, body.positions)
        self.can_meet, self._meet = faces.can_meet, faces.units_meet
        units, nodes = faces.unit_nodes, body.nodes
        count, triangles = len(units), len(faces.triangles)
        self.units = Units(
            np.concatenate(units), np.cumsum([0, *map(len, units)], dtype=np.int64), np.empty(count),
            np.zeros((count, count)), np.empty((count, 5, 3)),
        )  # fmt: skip
        self.long, self.short, self._quiet = (Allowance.room(nodes, count) for _ in range(3))
        first, listed = np.zeros(len(points) + 1, np.int64), np.empty(0, np.int64)
        self._long = LongList(first, listed, np.argsort(self.boxes.order), np.empty((triangles, 6)))
        self._short = ShortList.room(len(points), triangles)
        self.hits = np.zeros((2 * len(points), 2), np.int64)
        self._seen, self._slack_m, self._entries = np.empty((nodes, 3)), 0.0, (0, 0)
        self._forget()

    def _forget(self) -> None:
        """Let no list be valid."""
        self._long_m, self._short_m, self._quiet_m = -1.0, (-1.0, -1.0), (-1.0, -1.0)

    def over(self, x: Array, reach: float, behind: float, room_m: float, *, moves: bool) -> IntArray:
        """Return rows (k, 2), point and triangle, of what lies over what; they are overwritten by the next.

        Ascending by point, then by the triangle's unit.

        Args:
            x: (n, 3) [m].
            reach: largest distance in front of a triangle [m].
            behind: the same behind it [m].
            room_m: for which a new list is made, if the old one is not valid.
            moves: whether a new list is to hold for the next steps as well.
        """
        x = np.ascontiguousarray(x, dtype=float)
        self._update(x, reach, behind, room_m, moves)
        while (count := self._fill(x, reach, behind, self.hits)) > len(self.hits):
            self.hits = np.zeros((2 * count, 2), np.int64)
        return self.hits[:count]

    def press(
        self, x: Array, reach: float, behind: tuple[float, float], room_m: float, *, moves: bool
    ) -> bool:
        """Return whether any point lies over a triangle; if none does, for how small a motion is kept.

        Args:
            x: (n, 3) [m].
            reach: largest distance in front of a triangle [m].
            behind: the same behind it [m]: where no node is fast, and where one is.
            room_m: for which a new list is made, if the old one is not valid.
            moves: whether a new list is to hold for the next steps as well.
        """
        x = np.ascontiguousarray(x, dtype=float)
        if self._stays_quiet(x, reach, behind[0]):
            return False
        self._update(x, reach, behind[1], room_m, moves)
        if self._fill(x, reach, behind[1], self.hits[:0]) > 0:
            return True
        self._keep_quiet(x, reach, behind[1])
        return False

    def _fill(self, x: Array, reach: float, behind: float, out: IntArray) -> int:
        return int(unchecked(fill_over)(x, self.rows, self._short, self._entries[0], (reach, behind), out))

    def _update(self, x: Array, reach: float, behind: float, room_m: float, moves: bool) -> None:
        """Let the short list hold all that may be over a triangle, with the sides of its triangles."""
        while not self._serves(x, reach, behind):
            self.make(x, room_m, moves)

    def _serves(self, x: Array, reach: float, behind: float) -> bool:
        """Return whether the short list is valid, if need be made of the long one."""
        within = reach <= self._short_m[0] <= reach + _TOO_FAR_M and behind <= self._short_m[1]
        if within and unchecked(units_stay)(x, self.units, self.short, 0.0):
            measure_sides(x, self.rows.triangles, self._short.used, self._entries[1], self._short.sides)
            return True
        further = reach + _FURTHER_M
        # pairs of units that the long list leaves out may come nearer by the distance beyond its room
        less = max(max(further, behind) - self._long_m, 0.0) / FEET_FOLLOW
        if self._long_m < 0.0 or not unchecked(units_stay)(x, self.units, self.long, less):
            return False
        self._entries = unchecked(shorten_list)(x, self.rows, self._long, further, behind, self._short)
        self._short_m = further, behind
        self.units.went.fill(0.0)
        keep_shape(x, self.units, self.short)
        return True

    def make(self, x: Array, room_m: float, moves: bool) -> None:
        """Make a new long list.

        Args:
            x: (n, 3) [m], of the nodes.
            room_m: largest distance of a point from a triangle that is asked for.
            moves: whether it is to hold for the next steps as well.
        """
        margin = _MARGIN_M if moves else _MARGIN_AT_REST_M
        room = room_m + margin + foot_beside(x, self.rows.triangles)
        self._forget()
        self._list_around(x, room)
        allow_motion(x, self.units, self._meet, (room, margin), self.long.allowed, self.short.allowed)
        keep_shape(x, self.units, self.long)
        self._long_m = room_m

    def _list_around(self, x: Array, room_m: float) -> None:
        """Fill the long list with all that is so near a triangle."""
        long = self._long
        asked = x, self.rows, self.boxes, (room_m, 0.0), long.first
        while (needed := fill_list(*asked, long.listed)) > len(long.listed):
            room = needed + needed // 2
            self._long = long = long._replace(listed=np.empty(room, np.int64))
            self._short = self._short._replace(listed=np.empty(room, np.int64))

    def _stays_quiet(self, x: Array, reach: float, behind: float) -> bool:
        """Return whether still nothing of the film is over a triangle, as `_keep_quiet` has it.

        Most often no node has gone far since that was last seen, besides a rigid motion of all: two units
        have moved by no more than twice as much against each other.
        """
        if not (reach <= self._quiet_m[0] and behind <= self._quiet_m[1]):
            return False
        if 2.0 * furthest_gone(x, self._seen, self.units.nodes) <= self._slack_m:
            return True
        if not unchecked(units_stay)(x, self.units, self._quiet, 0.0):
            return False
        self._slack_m = least_left(self._quiet.allowed, self.units.went)
        np.copyto(self._seen, x)
        return True

    def _keep_quiet(self, x: Array, reach: float, behind: float) -> None:
        """Keep for how small a motion [m] nothing comes over a triangle."""
        went, allowed = self.units.went, self._quiet.allowed
        np.subtract(self.short.allowed, np.triu(went) + np.triu(went, 1).T, out=allowed)
        fill_quiet(x, self.rows, self._short, self._entries[0], (reach, behind), allowed)
        keep_shape(x, self.units, self._quiet)
        self._quiet_m, self._slack_m = (reach, behind), -1.0
