"""Outlines of sheets: lines joined where they nearly meet, the film within them, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from cosim.base.drawing import SAME_PLACE_M, DrawnLine
from cosim.base.extras import extra_module
from cosim.base.frames import Array, in_mm
from cosim.errors import MeshError

_SMALLEST_M: Final = 1e-3


def with_ends_met(lines: Sequence[DrawnLine]) -> list[DrawnLine]:
    """Return lines whose open ends lie exactly on what they nearly touch, `SAME_PLACE_M` at most away."""
    shapely = extra_module("shapely", "pattern")
    counts = [len(line.points) for line in lines]
    points = np.concatenate([np.zeros((0, 2)), *(line.points for line in lines)])
    last = np.cumsum(counts) - 1
    is_open = [len(line.points) > 1 and not line.closed for line in lines]
    ends = np.concatenate([last - counts + 1, last])[np.tile(is_open, 2)].astype(np.int64)
    movable = np.zeros(len(points), dtype=bool)
    movable[ends] = True
    near = cKDTree(points).query_ball_point(points[ends], SAME_PLACE_M)
    for end, around in sorted(zip(ends.tolist(), near, strict=True)):
        there = sorted(around, key=lambda other: (movable[other], other))
        points[end] = points[there[0]]
    walls = [shapely.LineString(part) for part in np.split(points, last[:-1] + 1) if len(part) > 1]
    for end, around in zip(ends.tolist(), near, strict=True):
        others = [wall for wall in walls if shapely.distance(shapely.Point(points[end]), wall) < SAME_PLACE_M]
        if len(around) == 1 and len(others) > 1:  # on another line, between its corners
            wall = max(others, key=lambda wall: shapely.distance(shapely.Point(points[end]), wall))
            points[end] = np.array(shapely.shortest_line(wall, shapely.Point(points[end])).coords)[0]
    return [
        replace(line, points=part) for line, part in zip(lines, np.split(points, last[:-1] + 1), strict=True)
    ]


def sheet_within(cut: Sequence[DrawnLine]) -> Any:
    """Return the film within outlines and without holes, as a shapely polygon.

    Raises:
        MeshError: an outline is open, crosses itself or touches another, or there are several pieces of film.
    """
    shapely = extra_module("shapely", "pattern")
    if not cut:
        raise MeshError("the pattern has no outline: layer CUT is empty")
    joined = shapely.unary_union([shapely.LineString(line.points) for line in cut], grid_size=1e-9)
    for line in cut:
        check_simple(line)
    _check_apart(cut)
    polygons, cuts, dangles, invalid = shapely.polygonize_full([joined])
    for open_line in [*dangles.geoms, *cuts.geoms, *invalid.geoms][:1]:
        end = _loose_end(open_line, joined)
        raise MeshError(f"the outline is open at {in_mm(end)}: close the line of layer CUT there")
    rings = shapely.polygonize([shapely.LineString(line.points) for line in cut]).geoms or polygons.geoms
    if not len(rings):
        raise MeshError("the outline encloses no area: close the lines of layer CUT")
    sheet = shapely.Polygon()
    for ring in sorted((shapely.Polygon(face.exterior) for face in rings), key=lambda face: -face.area):
        sheet = sheet.symmetric_difference(ring)
    if sheet.is_empty or sheet.geom_type != "Polygon":
        parts = sorted(getattr(sheet, "geoms", ()), key=lambda part: part.area)
        point = np.array(parts[0].representative_point().coords[0]) if parts else np.zeros(2)
        raise MeshError(
            f"the outline has {len(parts)} pieces side by side, one at {in_mm(point)}; a pattern has one, "
            "with holes in it"
        )
    size = np.ptp(np.array(sheet.exterior.coords), axis=0)
    if size.min() < _SMALLEST_M:
        raise MeshError(
            f"the outline is {1e3 * size[0]:.3g} x {1e3 * size[1]:.3g} mm; at least {1e3 * _SMALLEST_M:g} mm "
            "are meshed: is the unit right?"
        )
    return sheet


def _check_apart(lines: Sequence[DrawnLine]) -> None:
    """Refuse outlines that cross one another, and closed ones that touch another; one may be drawn twice."""
    shapely = extra_module("shapely", "pattern")
    drawn = [shapely.LineString(line.points) for line in lines]
    first, second = shapely.STRtree(drawn).query(drawn, predicate="intersects")
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        one, other = drawn[a], drawn[b]
        touching = (lines[a].closed or lines[b].closed) and not one.equals(other)
        if a < b and (touching or one.crosses(other)):
            point = np.array(shapely.intersection(one, other).representative_point().coords[0])
            how = "crosses" if one.crosses(other) else "touches"
            raise MeshError(f"{lines[a].where} {how} {lines[b].where} at {in_mm(point)}: draw them apart")


def check_simple(line: DrawnLine) -> None:
    """Refuse a line that crosses itself.

    Raises:
        MeshError: with the place where it does.
    """
    shapely = extra_module("shapely", "pattern")
    drawn = shapely.LineString(line.points)
    if drawn.is_simple:
        return
    noded = shapely.unary_union([drawn])
    ends = [np.array(piece.coords)[[0, -1]] for piece in getattr(noded, "geoms", (noded,))]
    own = np.array(drawn.coords)[[0, -1]]  # meet of themselves where it is closed
    cells, count = np.unique(
        np.round(np.concatenate([*ends, own]) / SAME_PLACE_M), axis=0, return_counts=True
    )
    count -= 2 * (cells[:, None] == np.round(own / SAME_PLACE_M)).all(axis=2).sum(axis=1)
    crossing = cells[np.argmax(count)] * SAME_PLACE_M
    raise MeshError(f"{line.where or 'a line'} crosses or covers itself at {in_mm(crossing)}")


def _loose_end(line: Any, lines: Any) -> Array:
    """Return the end of a line that meets no other."""
    shapely = extra_module("shapely", "pattern")
    ends = np.array(line.coords)[[0, -1]]
    others = shapely.difference(lines, line)
    if others.is_empty:
        return ends[1]
    return ends[int(np.argmax(shapely.distance(shapely.points(ends), others)))]


def check_within(line: DrawnLine, sheet: Any) -> None:
    """Refuse a line that leaves the sheet.

    Raises:
        MeshError: with the place where it does.
    """
    shapely = extra_module("shapely", "pattern")
    outside = shapely.difference(shapely.LineString(line.points), sheet.buffer(2.0 * SAME_PLACE_M))
    if not outside.is_empty:
        point = np.array(outside.representative_point().coords[0])
        raise MeshError(
            f"{line.where or 'a seam'} leaves the outline at {in_mm(point)}: draw it within layer CUT"
        )
