"""Which points of a film lie over which triangles of its other units: candidates, then foot on the plane.

A point is over a triangle if its foot on the plane lies in the triangle (`BEYOND_EDGES`, so that none slips
through between two) and its distance is in -behind .. reach. Of the triangles of one unit it gets the
nearest, and only if the two films face each other there; see `Relation`.
"""

from __future__ import annotations

import numpy as np

from cosim.base.kernels import IndexTable, Indices, Matrix, Vector, inlined, kernel, small_vector
from cosim.soft.contact.point_kernels import fill_point
from cosim.soft.contact.self_contact_candidates import (
    BEYOND_EDGES,
    VALLEY,
    FilmLists,
    least_weight,
    lists_serve,
    over_plane,
)

_UNITS_NEAR = 8  # other units over which one point can be at a time
_TIE_M = 1e-12  # two triangles at equal distance: the one in front of which the point lies more
_FACING_VALLEY, _FACING_APART = 0.0, 0.5  # largest cosine of the two outer normals, by `Relation`


@inlined
def _fill_outward(lists: FilmLists, p: int, outward: Vector) -> None:
    """Fill a point's outer normal, of unit length."""
    rows, sides, ox, oy, oz = lists.rows, lists.sides, 0.0, 0.0, 0.0
    for k in range(rows.start[p], rows.start[p + 1]):
        side = sides[rows.around[k]]
        ox, oy, oz = ox + side[12] * side[3], oy + side[12] * side[4], oz + side[12] * side[5]
    length = np.sqrt(ox * ox + oy * oy + oz * oz)
    outward[0], outward[1], outward[2] = ox / length, oy / length, oz / length


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
    fill_point(x, rows.nodes[p], rows.weights[p], place)
    px, py, pz = place[0], place[1], place[2]
    near, furthest, face, known = 0, max(reach, behind), rows.homes[p, 0], False
    for entry in range(short.first[p], short.first[p + 1]):
        t = short.listed[entry]
        d, valley = over_plane(sides[t], px, py, pz), rows.relation[face, rows.films[t, 0]] == VALLEY
        if d < -behind or d > (reach if valley else furthest):
            continue
        if not least_weight(sides[t], px, py, pz) >= -BEYOND_EDGES:
            continue
        if not known:
            _fill_outward(lists, p, outward)
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
        closer = abs(d) < best[slot] - _TIE_M
        if closer or (abs(d) < best[slot] + _TIE_M and d > distance[slot]):
            best[slot], distance[slot], chosen[slot] = abs(d), d, t if facing else -1
    return near


@kernel(allocates=True)
def find_over(x: Matrix, lists: FilmLists, reach: float, behind: float, out: IndexTable) -> int:
    """Fill rows (point, triangle) of what lies over what, ascending by point, then by the triangle's unit.

    Args:
        x: (n, 3) [m].
        lists: that may serve.
        reach: largest distance in front of a triangle [m].
        behind: the same behind it [m].
        out: (k, 2), filled.

    Returns:
        How many rows that takes, none of which are written beyond the room; -1 where the long list does not
        serve.
    """
    if not lists_serve(x, lists, reach, behind):
        return -1
    chosen, units = np.empty(_UNITS_NEAR, np.int64), np.empty(_UNITS_NEAR, np.int64)
    best, distance = small_vector(_UNITS_NEAR), small_vector(_UNITS_NEAR)
    rows, short, room, count = lists.rows, lists.short, (best, distance, chosen, units), 0
    for p in range(rows.nodes.shape[0]):
        if short.first[p] == short.first[p + 1]:
            continue
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
