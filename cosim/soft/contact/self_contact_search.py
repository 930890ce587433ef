"""Which points of a film lie over which triangles of its other units: candidates, then foot on the plane.

A point is over a triangle if its foot on the plane lies in the triangle (`BEYOND_EDGES`, so that none slips
through between two) and its distance is in -behind .. reach. Of the triangles of one unit it gets the
nearest, and only if the two films face each other there; see `Relation`.
"""

import numpy as np

from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import allocating, device_function, inlined, kernel, small_vector
from cosim.soft.contact import contact_law, self_contact_candidates
from cosim.soft.contact.self_contact_candidates import BEYOND_EDGES, VALLEY, FilmLists, FilmRows
from cosim.soft.contact.triangle_side import least_weight, over_plane

BEHIND_M = 5e-3  # how far behind a film a point still counts as one that came through it
_UNITS_NEAR = 8  # other units over which one point can be at a time
_TIE_M = 1e-12  # two triangles at equal distance: the one in front of which the point lies more
_FACING_VALLEY, _FACING_APART = 0.0, 0.5  # largest cosine of the two outer normals, by `Relation`


@device_function
def _fill_outward(x: Matrix, rows: FilmRows, p: int, outward: Vector) -> None:
    """Fill a point's outer normal, of unit length."""
    normal, square = small_vector(3), 0.0
    outward[:] = 0.0
    for k in range(rows.start[p], rows.start[p + 1]):
        shrink = contact_law.plane_of(x, rows.triangles[rows.around[k]], normal)
        for r in range(3):
            outward[r] += normal[r] / shrink
    for r in range(3):
        square += outward[r] * outward[r]
    for r in range(3):
        outward[r] /= np.sqrt(square)


@inlined
def _choose(
    x: Matrix,
    lists: FilmLists,
    p: int,
    reach: float,
    behind: float,
    room: tuple[Vector, Vector, Indices, Indices],
) -> int:
    """Fill of each unit that a point is over its distance, the nearest triangle, and its number.

    The triangle is -1 where the two do not face each other there.

    Returns:
        Over how many units it is.
    """
    rows, short, sides, place, outward = (
        lists.rows,
        lists.short,
        lists.sides,
        small_vector(3),
        small_vector(3),
    )
    best, distance, chosen, units = room
    contact_law.fill_point(x, rows.nodes[p], rows.weights[p], place)
    px, py, pz = place[0], place[1], place[2]
    near, furthest, face, known = 0, max(reach, behind), rows.homes[p, 0], False
    for entry in range(short.first[p], short.first[p + 1]):
        t = short.listed[entry]
        d, valley = over_plane(sides[t], px, py, pz), rows.relation[face, rows.films[t, 0]] == VALLEY
        if d < -behind or d + rows.spare[p] > (reach if valley else furthest):
            continue
        if not least_weight(sides[t], px, py, pz) >= -BEYOND_EDGES:
            continue
        if not known:
            _fill_outward(x, rows, p, outward)
            known = True
        cosine = outward[0] * sides[t, 3] + outward[1] * sides[t, 4] + outward[2] * sides[t, 5]
        facing = cosine < (_FACING_VALLEY if valley else _FACING_APART)
        if valley and not facing:
            continue
        slot = 0
        while slot < near and units[slot] != rows.films[t, 1]:
            slot += 1
        if slot == _UNITS_NEAR:
            continue
        if slot == near:
            near, units[slot], best[slot], distance[slot] = near + 1, rows.films[t, 1], np.inf, -np.inf
        closer, spared = abs(d) < best[slot] - _TIE_M, d + rows.spare[p]
        if closer or (abs(d) < best[slot] + _TIE_M and spared > distance[slot]):
            best[slot], distance[slot], chosen[slot] = abs(d), spared, t if facing else -1
    return near


@kernel(allocates=True)
def find_over(x: Matrix, lists: FilmLists, reach: float, behind: float, out: IndexTable) -> int:
    """Fill rows (point, triangle) of what lies over what, ascending by point, then by the triangle's unit.

    Args:
        x: (n, 3) [m].
        lists: that may be valid.
        reach: largest distance in front of a triangle [m].
        behind: the same behind it [m].
        out: (k, 2), filled.

    Returns:
        How many rows that takes, none of which are written beyond the room; -1 where the long list does not
        serve.
    """
    if not self_contact_candidates.lists_serve(x, lists, reach, behind):
        return -1
    return fill_over(x, lists, reach, behind, out)


@allocating
def fill_over(x: Matrix, lists: FilmLists, reach: float, behind: float, out: IndexTable) -> int:
    """Fill the rows of `find_over` from the short list; return how many that takes."""
    chosen, units = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR, np.int64)
    best, distance = small_vector(_UNITS_NEAR), small_vector(_UNITS_NEAR)
    rows, room, count = lists.rows, (best, distance, chosen, units), 0
    for k in range(lists.counts[0]):
        p = lists.points[k]
        near, begin = _choose(x, lists, p, reach, behind, room), count
        for slot in range(near):
            if chosen[slot] < 0 or not distance[slot] < reach:
                continue
            if count < out.shape[0]:
                at = count
                while at > begin and rows.films[out[at - 1, 1], 1] > units[slot]:
                    out[at, 1] = out[at - 1, 1]
                    at -= 1
                out[count, 0], out[at, 1] = p, chosen[slot]
            count += 1
    return count
