"""Search for points of a film over triangles of other units, with the foot within the triangle.

A point is over a triangle if its foot on the plane lies in the triangle (extended by `BEYOND_EDGES`) and its
distance is in -behind .. reach. Of the triangles of one unit only the nearest counts, if the two films
face each other there; see `Relation`.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, inlined, kernel, small_vector
from cosim.soft.contact import triangle_foot
from cosim.soft.contact.self_contact_candidates import BEYOND_EDGES, VALLEY, FilmRows
from cosim.soft.contact.triangle_side import least_weight, measure_side, over_plane

BEHIND_M = 5e-3  # depth behind a film up to which a point counts as having penetrated it
_UNITS_NEAR = 8  # largest number of other units over one point
_TIE_M = 1e-12  # of equal distances, the triangle with the point more in front of it counts
_FACING_VALLEY, _FACING_APART = 0.0, 0.5  # largest cosine of the two outer normals, by `Relation`


class ShortList(NamedTuple):
    """Triangles that points may be over.

    Args:
        first: (p + 1,), start of each point's triangles in `listed`.
        listed: triangles, ascending for each point.
        points: (p,), the points with an entry come first.
        used: (t,), the triangles with an entry come first.
        sides: (t, 13), see `measure_side`, of the used triangles.
    """

    first: Indices
    listed: Indices
    points: Indices
    used: Indices
    sides: Matrix

    @classmethod
    def empty(cls, points: int, triangles: int) -> "ShortList":
        """Return an empty list for a film, given its numbers of points and triangles."""
        first, listed = np.zeros(points + 1, np.int64), np.empty(0, np.int64)
        used = np.zeros(points, np.int64), np.zeros(triangles, np.int64)
        return cls(first, listed, *used, np.empty((triangles, 13)))


@device_function
def add_ascending(short: ShortList, p: int, t: int, at: int) -> None:
    """Insert a triangle in ascending order for the last point p of a list that ends at `at`."""
    while at > short.first[p] and short.listed[at - 1] > t:
        short.listed[at] = short.listed[at - 1]
        at -= 1
    short.listed[at] = t


@kernel
def measure_sides(x: Matrix, triangles: IndexTable, used: Indices, count: int, sides: Matrix) -> None:
    """Fill the sides of the first `count` of the used triangles.

    Args:
        x: (n, 3) [m].
        triangles: (t, 3).
        used: (t,), indices of triangles.
        count: number of used triangles.
        sides: (t, 13), filled, see `measure_side`.
    """
    for k in range(count):
        t = used[k]
        measure_side(x, triangles[t], sides[t])


@device_function
def _fill_outward(x: Matrix, rows: FilmRows, p: int, outward: Vector) -> None:
    """Fill a point's outer unit normal: the area-weighted mean of the triangles around it."""
    square = 0.0
    outward[:] = 0.0
    for k in range(rows.start[p], rows.start[p + 1]):
        corners = rows.triangles[rows.around[k]]
        a, b, c = corners[0], corners[1], corners[2]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        outward[0], outward[1] = outward[0] + uy * vz - uz * vy, outward[1] + uz * vx - ux * vz
        outward[2] += ux * vy - uy * vx
    for r in range(3):
        square += outward[r] * outward[r]
    for r in range(3):
        outward[r] /= np.sqrt(square)


@device_function
def _nearest(short: ShortList, p: int, behind: float, px: float, py: float, pz: float) -> float:
    """Return a point's least distance from the planes of its triangles, at most `behind` them."""
    least_distance = np.inf
    for entry in range(short.first[p], short.first[p + 1]):
        d = over_plane(short.sides[short.listed[entry]], px, py, pz)
        if d >= -behind:
            least_distance = min(least_distance, d)
    return least_distance


@inlined
def _choose(
    x: Matrix,
    rows: FilmRows,
    short: ShortList,
    p: int,
    bounds: tuple[float, float],
    room: tuple[Vector, Vector, Vector, Vector],
) -> int:
    """Fill, for each unit under a point, distance, nearest triangle, and the unit's index.

    The triangle is -1 if the two films do not face each other there.

    Returns:
        Number of units.
    """
    sides, point, outward = short.sides, small_vector(3), small_vector(3)
    (reach, behind), (best, distance, chosen, units) = bounds, room
    triangle_foot.fill_point(x, rows.nodes[p], rows.weights[p], point)
    px, py, pz = point[0], point[1], point[2]
    unit_count, furthest, face, outward_known = 0, max(reach, behind), rows.homes[p, 0], False
    spare = rows.spare[p]
    if not _nearest(short, p, behind, px, py, pz) + spare < reach:  # most points
        return unit_count
    for entry in range(short.first[p], short.first[p + 1]):
        t = short.listed[entry]
        d = over_plane(sides[t], px, py, pz)
        if d < -behind or d + spare > furthest or not least_weight(sides[t], px, py, pz) >= -BEYOND_EDGES:
            continue
        valley = rows.relation[face, rows.films[t, 0]] == VALLEY
        if valley and d + spare > reach:
            continue
        if not outward_known:
            _fill_outward(x, rows, p, outward)
            outward_known = True
        cosine = outward[0] * sides[t, 3] + outward[1] * sides[t, 4] + outward[2] * sides[t, 5]
        facing = cosine < (_FACING_VALLEY if valley else _FACING_APART)
        if valley and not facing:
            continue
        slot = 0
        while slot < unit_count and units[slot] != rows.films[t, 1]:
            slot += 1
        if slot == _UNITS_NEAR:
            continue
        if slot == unit_count:
            units[slot], best[slot], distance[slot] = rows.films[t, 1], np.inf, -np.inf
            unit_count += 1
        closer, spared = abs(d) < best[slot] - _TIE_M, d + spare
        if closer or (abs(d) < best[slot] + _TIE_M and spared > distance[slot]):
            best[slot], distance[slot], chosen[slot] = abs(d), spared, t if facing else -1
    return unit_count


@kernel
def fill_over(
    x: Matrix, rows: FilmRows, short: ShortList, points: int, bounds: tuple[float, float], out: IndexTable
) -> int:
    """Fill pairs (point, triangle) of points over triangles, ascending by point, then by the triangle's unit.

    Args:
        x: (n, 3) [m].
        rows: of the film.
        short: valid list, with the sides of its triangles.
        points: number of points with an entry.
        bounds: largest distance in front of a triangle, and behind it [m].
        out: (k, 2), filled.

    Returns:
        Number of pairs; those beyond the size of `out` are not written.
    """
    # indices of triangles and units are stored as floats, which fit on the stack
    best, distance = small_vector(_UNITS_NEAR), small_vector(_UNITS_NEAR)
    chosen, units = small_vector(_UNITS_NEAR), small_vector(_UNITS_NEAR)
    room, count, reach = (best, distance, chosen, units), 0, bounds[0]
    for k in range(points):
        p = short.points[k]
        near, begin = _choose(x, rows, short, p, bounds, room), count
        for slot in range(near):
            if chosen[slot] < 0.0 or not distance[slot] < reach:
                continue
            if count < out.shape[0]:
                at = count
                while at > begin and rows.films[out[at - 1, 1], 1] > units[slot]:
                    out[at, 1] = out[at - 1, 1]
                    at -= 1
                out[count, 0], out[at, 1] = p, int(chosen[slot])
            count += 1
    return count
