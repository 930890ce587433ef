"""Meshes of flat sheets: lines that must be edges, and points that must be nodes, within an outline.

Lines are cut at their crossings, then divided into equal edges between their corners. A hexagonal lattice
fills the sheet; a constrained Delaunay triangulation joins all nodes, is refined where angles are small,
and free nodes move to the mean of their neighbours. Mirror-symmetric sheets are meshed on one side and
mirrored, so that the mesh is symmetric. Lines of an outline are joined where they nearly meet.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Any, Final, final

import numpy as np
import scipy

from cosim.base.drawing import SAME_PLACE_M, DrawnLine
from cosim.base.frames import Array, IntArray, Mask, in_mm
from cosim.base.resources import extra_module
from cosim.errors import MeshError

_SMALLEST_M: Final = 1e-3


def with_ends_met(lines: Sequence[DrawnLine]) -> list[DrawnLine]:
    """Return lines with open ends moved onto points and lines that are at most `SAME_PLACE_M` away."""
    shapely = extra_module("shapely", "pattern")
    counts = [len(line.points) for line in lines]
    points = np.concatenate([np.zeros((0, 2)), *(line.points for line in lines)])
    last = np.cumsum(counts) - 1
    is_open = [len(line.points) > 1 and not line.closed for line in lines]
    ends = np.concatenate([last - counts + 1, last])[np.tile(is_open, 2)].astype(np.int64)
    movable = np.zeros(len(points), dtype=bool)
    movable[ends] = True
    near_points = scipy.spatial.cKDTree(points).query_ball_point(points[ends], SAME_PLACE_M)
    for end, around in sorted(zip(ends.tolist(), near_points, strict=True)):
        by_priority = sorted(around, key=lambda index: (movable[index], index))
        points[end] = points[by_priority[0]]
    walls = [shapely.LineString(part) for part in np.split(points, last[:-1] + 1) if len(part) > 1]
    for end, around in zip(ends.tolist(), near_points, strict=True):
        near_walls = [
            wall for wall in walls if shapely.distance(shapely.Point(points[end]), wall) < SAME_PLACE_M
        ]
        if len(around) == 1 and len(near_walls) > 1:  # on another line, between its corners
            wall = max(near_walls, key=lambda wall: shapely.distance(shapely.Point(points[end]), wall))
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
        pieces = sorted(getattr(sheet, "geoms", ()), key=lambda polygon: polygon.area)
        point = np.array(pieces[0].representative_point().coords[0]) if pieces else np.zeros(2)
        raise MeshError(
            f"the outline has {len(pieces)} pieces side by side, one at {in_mm(point)}; a pattern has one, "
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
    outlines = [shapely.LineString(line.points) for line in lines]
    first, second = shapely.STRtree(outlines).query(outlines, predicate="intersects")
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        outline, other_outline = outlines[a], outlines[b]
        touching = (lines[a].closed or lines[b].closed) and not outline.equals(other_outline)
        if a < b and (touching or outline.crosses(other_outline)):
            point = np.array(shapely.intersection(outline, other_outline).representative_point().coords[0])
            how = "crosses" if outline.crosses(other_outline) else "touches"
            raise MeshError(f"{lines[a].where} {how} {lines[b].where} at {in_mm(point)}: draw them apart")


def check_simple(line: DrawnLine) -> None:
    """Refuse a line that crosses itself.

    Raises:
        MeshError: with the place where it does.
    """
    shapely = extra_module("shapely", "pattern")
    shape = shapely.LineString(line.points)
    if shape.is_simple:
        return
    noded = shapely.unary_union([shape])
    ends = [np.array(piece.coords)[[0, -1]] for piece in getattr(noded, "geoms", (noded,))]
    own_ends = np.array(shape.coords)[[0, -1]]  # meet of themselves where it is closed
    cells, count = np.unique(
        np.round(np.concatenate([*ends, own_ends]) / SAME_PLACE_M), axis=0, return_counts=True
    )
    count -= 2 * (cells[:, None] == np.round(own_ends / SAME_PLACE_M)).all(axis=2).sum(axis=1)
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


_GRID_M: Final = 1e-9
_AROUND_HOLE: Final = 32
"""Edges around an open hole, at least: joined units bend there, and too few make them stiff."""
_CORNER_RAD: Final = math.radians(25.0)
_CLEAR: Final = 0.62  # of the edge length, between lattice and lines
_ROUNDS, _SWEEPS = 4, 6
_LEAST_ANGLE_RAD: Final = math.radians(20.0)
_SLIVER: Final = 1e-6  # area over the square of the longest edge
MOST_TRIANGLES: Final = 40_000


class LineKind(IntFlag):
    """Kind of a line of a sheet; one line may have several."""

    CUT = 1
    SEAL = 2
    FOLD = 4
    OTHER = 8
    HOLE = 16


@final
@dataclass(frozen=True)
class FlatLine:
    """A line on a sheet.

    Args:
        points: (k, 2) [m]; a closed line ends with its first point.
        kind: one or several.
    """

    points: Array
    kind: LineKind

    def mirrored(self, axis: int, at_m: float) -> "FlatLine":
        """Return the line mirrored in the line where coordinate `axis` is `at_m`."""
        return replace(self, points=mirrored(self.points, axis, at_m))


@final
@dataclass(frozen=True)
class FlatMesh:
    """A triangulated sheet.

    Args:
        positions: (n, 2) [m].
        triangles: (m, 3), counter-clockwise.
        edges: (e, 2) node indices of the edges that lie on lines, ascending in each row.
        kinds: (e,) `LineKind` of each.
    """

    positions: Array
    triangles: IntArray
    edges: IntArray
    kinds: IntArray

    def edges_of(self, kind: LineKind) -> IntArray:
        """Return the edges (k, 2) on lines of a kind."""
        return self.edges[(self.kinds & int(kind)) != 0]


def mirrored(points: Array, axis: int, at_m: float) -> Array:
    """Return points (k, 2) mirrored in the line where a coordinate has a value."""
    image = np.array(points)
    image[:, axis] = 2.0 * at_m - image[:, axis]
    return image


def mesh_sheet(sheet: Any, lines: Sequence[FlatLine], points: Array, edge_m: float) -> FlatMesh:
    """Return the mesh of a sheet.

    Args:
        sheet: shapely polygon or polygons of the film, its boundary among the lines of kind CUT.
        lines: that become edges; parts beyond the sheet are left out.
        points: (k, 2) [m] that become nodes.
        edge_m: length of an edge.

    Raises:
        MeshError: there would be too many triangles, or the lines leave no room for edges of that length.
    """
    if sheet.area / (0.433 * edge_m**2) > MOST_TRIANGLES:
        shortest_m = math.sqrt(sheet.area / (0.433 * MOST_TRIANGLES))
        raise MeshError(
            f"edges of {1e3 * edge_m:.3g} mm make more than {MOST_TRIANGLES} triangles of this outline; "
            f"set mesh_m to {shortest_m:.1g} or more"
        )
    axes = _axes(sheet, lines)
    for axis, at_m in axes:
        points = np.concatenate([points, mirrored(points, axis, at_m)])
        lines = [*lines, *(line.mirrored(axis, at_m) for line in lines if line.kind == LineKind.OTHER)]
    circumferences_m = [
        np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum()
        for line in lines
        if line.kind == LineKind.HOLE
    ]
    hole_m = min([edge_m, *(float(length) / _AROUND_HOLE for length in circumferences_m)])
    part_of_sheet, lines_of_part = sheet, list(lines)
    for axis, at_m in axes:
        part_of_sheet, lines_of_part = _half(part_of_sheet, lines_of_part, axis, at_m)
        points = points[points[:, axis] >= at_m - SAME_PLACE_M]
    mesh = _meshed(part_of_sheet, lines_of_part, _distinct(points), (edge_m, hole_m))
    for axis, at_m in reversed(axes):
        mesh = _doubled(mesh, axis, at_m)
    return mesh


def _axes(sheet: Any, lines: Sequence[FlatLine]) -> list[tuple[int, float]]:
    """Return the coordinates (axis, value) of the lines in which the sheet and its seams are symmetric."""
    shapely = extra_module("shapely", "pattern")
    low_x, low_y, high_x, high_y = sheet.bounds
    symmetry_axes = []
    for axis, at_m in ((0, 0.5 * (low_x + high_x)), (1, 0.5 * (low_y + high_y))):
        alike = True
        for kind in (LineKind.CUT, LineKind.SEAL, LineKind.FOLD, LineKind.HOLE):
            selected = [line for line in lines if line.kind & kind]
            drawn = shapely.MultiLineString([line.points for line in selected])
            image = shapely.MultiLineString([line.mirrored(axis, at_m).points for line in selected])
            alike = alike and (not selected or shapely.difference(drawn, image.buffer(SAME_PLACE_M)).is_empty)
        if alike:
            symmetry_axes.append((axis, at_m))
    return symmetry_axes


def _half(sheet: Any, lines: list[FlatLine], axis: int, at_m: float) -> tuple[Any, list[FlatLine]]:
    """Return the part of a sheet and its lines beyond a coordinate's value, closed by a line there."""
    shapely = extra_module("shapely", "pattern")
    low, high = np.array(sheet.bounds[:2]) - 1.0, np.array(sheet.bounds[2:]) + 1.0
    low[axis] = at_m
    lines_of_half = []
    for line in lines:
        points = np.array(line.points)
        points[np.abs(points[:, axis] - at_m) < SAME_PLACE_M, axis] = at_m  # not just outside, by rounding
        pieces = _pieces(shapely.intersection(shapely.LineString(points), shapely.box(*low, *high)))
        lines_of_half += [replace(line, points=np.array(piece.coords)) for piece in pieces]
    ends = np.array([low, high])
    ends[:, axis] = at_m
    axis_lines = _pieces(shapely.intersection(shapely.LineString(ends), sheet))
    lines_of_half += [FlatLine(np.array(piece.coords), LineKind.OTHER) for piece in axis_lines]
    return shapely.intersection(sheet, shapely.box(*low, *high)), lines_of_half


def _pieces(geometry: Any) -> list[Any]:
    """Return the lines in a shapely geometry, without its points."""
    if geometry.geom_type == "LineString":
        return [] if geometry.is_empty else [geometry]
    return [piece for member in getattr(geometry, "geoms", ()) for piece in _pieces(member)]


def _distinct(points: Array) -> Array:
    """Return points (k, 2) without those that are in the place of another."""
    cells = np.round(points / SAME_PLACE_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return points[np.sort(first)]


def _meshed(sheet: Any, lines: Sequence[FlatLine], points: Array, lengths: tuple[float, float]) -> FlatMesh:
    """Return the mesh of a sheet, symmetric or not, with edges of a length [m], and of one around holes."""
    edge_m, _ = lengths
    nodes, edges, kinds = _divided(sheet, lines, points, lengths)
    fixed = np.concatenate([nodes, points[_away(points, nodes, SAME_PLACE_M)]])
    lattice = _lattice(sheet, fixed, nodes[edges], edge_m)
    positions = np.concatenate([fixed, lattice])
    triangles, positions, edges, kinds = _triangulated(sheet, positions, edges, kinds)
    free = np.arange(len(positions)) >= len(fixed)
    free[edges] = False
    for _ in range(_ROUNDS):
        positions = _smoothed(positions, triangles, free)
        triangles = _delaunay(sheet, positions, edges)
    used_nodes = np.unique(triangles)
    number = np.full(len(positions), -1)
    number[used_nodes] = np.arange(len(used_nodes))
    remains = (number[edges] >= 0).all(axis=1)
    return FlatMesh(
        positions[used_nodes], number[triangles], np.sort(number[edges[remains]], axis=1), kinds[remains]
    )


def _divided(
    sheet: Any, lines: Sequence[FlatLine], points: Array, lengths: tuple[float, float]
) -> tuple[Array, IntArray, IntArray]:
    """Return nodes (n, 2), edges (e, 2) and kinds (e,) of lines, cut where they cross and divided."""
    shapely = extra_module("shapely", "pattern")
    joined = shapely.unary_union([shapely.LineString(line.points) for line in lines], grid_size=_GRID_M)
    joined = shapely.intersection(joined, sheet.buffer(SAME_PLACE_M))
    ends = np.concatenate([_segments(piece) for piece in _pieces(joined)])
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0.0]
    middles = shapely.points(ends.mean(axis=1))
    kinds = np.zeros(len(ends), np.int64)
    for kind in LineKind:
        of_kind_points = [line.points for line in lines if line.kind & kind]
        if of_kind_points:
            is_on_kind = (
                shapely.distance(middles, shapely.MultiLineString(of_kind_points)) < 0.5 * SAME_PLACE_M
            )
            kinds[is_on_kind] |= int(kind)
    edges: list[Array] = []
    kind_of_edges: list[int] = []
    for chain, kinds_there in _chains(ends, kinds, points):
        open_hole = kinds_there & (LineKind.HOLE | LineKind.SEAL) == LineKind.HOLE
        pieces = _resampled(chain, lengths[open_hole])
        edges.append(np.stack([pieces[:-1], pieces[1:]], axis=1))
        kind_of_edges += [kinds_there] * (len(pieces) - 1)
    edge_ends = np.concatenate(edges)
    end_points = edge_ends.reshape(-1, 2)
    _, first, node_of_end = np.unique(
        np.round(end_points / (0.25 * SAME_PLACE_M)).astype(np.int64),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    return end_points[first], node_of_end.reshape(-1, 2), np.array(kind_of_edges)


def _segments(line: Any) -> Array:
    points = np.array(line.coords)
    return np.stack([points[:-1], points[1:]], axis=1)


def _chains(ends: Array, kinds: IntArray, stops: Array) -> Iterable[tuple[Array, int]]:
    """Yield points (k, 2) and kind of each line between junctions, corners and stops.

    Args:
        ends: (s, 2, 2) [m], of segments that meet at their ends only.
        kinds: (s,) of each.
        stops: (k, 2) [m], points that must stay.
    """
    end_points = ends.reshape(-1, 2)
    _, first, node_of_end = np.unique(
        np.round(end_points / (0.25 * SAME_PLACE_M)).astype(np.int64),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    x, pairs = end_points[first], node_of_end.reshape(-1, 2)
    around: dict[int, list[int]] = {}
    for row, (a, b) in enumerate(pairs.tolist()):
        if a != b:
            around.setdefault(a, []).append(row)
            around.setdefault(b, []).append(row)
    fixed = {node for node, rows in around.items() if _is_end(x, pairs, kinds, node, rows)}
    if len(stops):
        fixed |= set(np.flatnonzero(~_away(x, stops, SAME_PLACE_M)).tolist())
    remaining_rows = {row for rows in around.values() for row in rows}
    starts = [*sorted(fixed), *sorted(around, key=lambda node: tuple(x[node]))]
    for start in starts:
        while rows := [row for row in around[start] if row in remaining_rows]:
            row, end_node, chain = min(rows), start, [start]
            kind = int(kinds[row])
            while True:
                remaining_rows.discard(row)
                end_node = int(pairs[row].sum()) - end_node
                chain.append(end_node)
                following = [next_row for next_row in around[end_node] if next_row in remaining_rows]
                if end_node in fixed or end_node == start or not following:
                    break
                row = following[0]
            yield x[chain], kind


def _is_end(x: Array, pairs: IntArray, kinds: IntArray, node: int, rows: list[int]) -> bool:
    """Return whether lines end at a node: a junction, a corner, or where one kind becomes another."""
    if len(rows) != 2 or kinds[rows[0]] != kinds[rows[1]]:
        return True
    before, after = (x[pairs[row].sum() - node] - x[node] for row in rows)
    turn = abs(math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after)))
    return math.pi - turn > _CORNER_RAD


def _resampled(points: Array, edge_m: float) -> Array:
    """Return a line's points at equal distances along it, as near to an edge's length as they can be."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    closed = bool((points[0] == points[-1]).all())
    parts = max(8 if closed else 1, round(length[-1] / edge_m))
    at = np.linspace(0.0, length[-1], parts + 1)[1:-1]
    inner = np.stack([np.interp(at, length, points[:, k]) for k in range(2)], axis=1)
    return np.concatenate([points[:1], inner, points[-1:]])


def _away(points: Array, others: Array, distance_m: float) -> Mask:
    """Return which points (k,) are further than a distance from all others."""
    if not len(others) or not len(points):
        return np.ones(len(points), dtype=bool)
    return np.asarray(scipy.spatial.cKDTree(others).query(points)[0] > distance_m)


def _lattice(sheet: Any, fixed: Array, segments: Array, edge_m: float) -> Array:
    """Return a hexagonal lattice (k, 2) in a sheet, clear of its lines and fixed nodes; rows along x.

    It begins at the lower left corner of the sheet, on whose sides axes of symmetry lie.
    """
    shapely = extra_module("shapely", "pattern")
    low_x, low_y, high_x, high_y = sheet.bounds
    rise = 0.5 * math.sqrt(3.0) * edge_m
    rows = np.arange(int((high_y - low_y) / rise) + 2)
    columns = np.arange(int((high_x - low_x) / edge_m) + 2)
    j, i = (index.ravel() for index in np.meshgrid(rows, columns, indexing="ij"))
    points = np.stack([low_x + (i + 0.5 * (j % 2)) * edge_m, low_y + j * rise], axis=1)
    places = shapely.points(points)
    inside = shapely.contains_properly(sheet, places)
    points, places = points[inside], places[inside]
    clear = shapely.distance(places, shapely.MultiLineString(list(segments))) > _CLEAR * edge_m
    return points[clear & _away(points, fixed, _CLEAR * edge_m)]


def _triangulated(
    sheet: Any, positions: Array, edges: IntArray, kinds: IntArray
) -> tuple[IntArray, Array, IntArray, IntArray]:
    """Return triangles, positions, edges and kinds, refined where angles are small."""
    cdt = extra_module("pythoncdt", "pattern")
    triangulation = _constrained(positions, edges)
    outer, room = triangulation.collect_outer_triangles(), len(positions) // 2 + 50
    triangulation.refine_triangles(
        room, cdt.RefinementCriterion.SMALLEST_ANGLE, _LEAST_ANGLE_RAD, outer, 10.0 * SAME_PLACE_M
    )
    triangulation.erase_super_triangle()
    vertices = triangulation.vertices_array()
    refined_positions = np.stack([vertices["x"], vertices["y"]], axis=1)
    kind_of_edge = {
        (min(a, b), max(a, b)): int(kind) for (a, b), kind in zip(edges.tolist(), kinds, strict=True)
    }
    origin = {(edge.v1, edge.v2): original for edge, original in triangulation.piece_to_originals_iter()}
    fixed = [(edge.v1, edge.v2) for edge in triangulation.fixed_edges_iter()]
    new_kinds = [
        int(np.bitwise_or.reduce([kind_of_edge[original.v1, original.v2] for original in origin[pair]]))
        if pair in origin
        else kind_of_edge[pair]
        for pair in fixed
    ]
    new_edges = np.array(fixed, dtype=np.int64).reshape(-1, 2)
    return _delaunay(sheet, refined_positions, new_edges), refined_positions, new_edges, np.array(new_kinds)


def _constrained(positions: Array, edges: IntArray) -> Any:
    cdt = extra_module("pythoncdt", "pattern")
    triangulation = cdt.Triangulation(
        cdt.VertexInsertionOrder.AUTO, cdt.IntersectingConstraintEdges.NOT_ALLOWED, 0.0
    )
    try:
        triangulation.insert_vertices([cdt.V2d(x, y) for x, y in positions.tolist()])
        triangulation.insert_edges([cdt.Edge(a, b) for a, b in edges.tolist()])
    except RuntimeError as error:
        raise MeshError(
            f"the lines of the sheet leave no room for edges of this length: set mesh_m to less ({error})"
        ) from error
    return triangulation


def _delaunay(sheet: Any, positions: Array, edges: IntArray) -> IntArray:
    """Return the triangles (m, 3) within a sheet, counter-clockwise, with the given edges."""
    shapely = extra_module("shapely", "pattern")
    triangulation = _constrained(positions, edges)
    triangulation.erase_super_triangle()
    triangles = triangulation.triangles_array()["vertices"].astype(np.int64)
    middles = positions[triangles].mean(axis=1)
    shapely.prepare(sheet)
    inside = shapely.contains_xy(sheet, middles[:, 0], middles[:, 1])
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    longest = np.maximum.reduce([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))])
    # nodes of a straight edge may be next to it by rounding, with slivers beyond
    return _ordered(triangles[inside & (signed_area(positions, triangles) > _SLIVER * longest)])


def _ordered(triangles: IntArray) -> IntArray:
    """Return triangles (m, 3) in the order of their nodes, so that meshes that are alike are equal."""
    first = (triangles.argmin(axis=1)[:, None] + np.arange(3)) % 3
    turned = np.take_along_axis(triangles, first, axis=1)
    return np.asarray(turned[np.lexsort(turned.T[::-1])])


def signed_area(positions: Array, triangles: IntArray) -> Array:
    """Return the area (m,) [m^2] of flat triangles, positive counter-clockwise."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    edge_ab, edge_ac = b - a, c - a
    return np.asarray(0.5 * (edge_ab[:, 0] * edge_ac[:, 1] - edge_ab[:, 1] * edge_ac[:, 0]))


def _smoothed(positions: Array, triangles: IntArray, free: Mask) -> Array:
    """Return positions with free nodes moved towards the means of their neighbours; none turns a triangle."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    count = np.bincount(pairs.ravel(), minlength=len(positions)).clip(1)
    x = positions
    for _ in range(_SWEEPS):
        total = np.zeros_like(x)
        np.add.at(total, pairs[:, 0], x[pairs[:, 1]])
        np.add.at(total, pairs[:, 1], x[pairs[:, 0]])
        moved = np.where(free[:, None], total / count[:, None], x)
        turned = signed_area(moved, triangles) < 0.1 * signed_area(x, triangles)
        moved[np.unique(triangles[turned])] = x[np.unique(triangles[turned])]
        if (signed_area(moved, triangles) <= 0.0).any():
            break
        x = moved
    return x


def _doubled(mesh: FlatMesh, axis: int, at_m: float) -> FlatMesh:
    """Return a half mesh with its mirror image; nodes on the axis stay single."""
    x = np.array(mesh.positions)
    on_axis = np.abs(x[:, axis] - at_m) < 0.5 * SAME_PLACE_M
    x[on_axis, axis] = at_m
    image_node = np.where(on_axis, np.arange(len(x)), len(x) - 1 + np.cumsum(~on_axis))
    positions = np.concatenate([x, mirrored(x[~on_axis], axis, at_m)])
    edges = np.sort(np.concatenate([mesh.edges, image_node[mesh.edges]]), axis=1)
    edges, first = np.unique(edges, axis=0, return_index=True)
    return FlatMesh(
        positions,
        np.concatenate([mesh.triangles, image_node[mesh.triangles][:, ::-1]]),
        edges,
        np.concatenate([mesh.kinds, mesh.kinds])[first],
    )


def smallest_angles(positions: Array, triangles: IntArray) -> Array:
    """Return the smallest angle (m,) [rad] of each triangle, of positions (n, 2) or (n, 3) [m]."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    sides = np.sort(
        [np.linalg.norm(b - c, axis=1), np.linalg.norm(c - a, axis=1), np.linalg.norm(a - b, axis=1)], 0
    )
    cosine = (sides[1] ** 2 + sides[2] ** 2 - sides[0] ** 2) / (2.0 * sides[1] * sides[2])
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
