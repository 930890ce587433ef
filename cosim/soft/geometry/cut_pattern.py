"""Cut patterns: two equal sheets welded along seams, as a flat film with named nodes.

Every area that a port leads into is a chamber, up to the seams around it. In every other area the sheets are
welded flat: both lie on the same nodes, so they stretch and bend together and the gas between them has no
volume. A seam is a line whose nodes both sheets share.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, final

import numpy as np
import scipy

from cosim.base.drawing import SAME_PLACE_M, DrawnLine
from cosim.base.frames import Array, IntArray, Mask, in_mm
from cosim.base.resources import extra_module
from cosim.errors import MeshError
from cosim.soft.geometry import flat_mesh, surface
from cosim.soft.geometry.flat_mesh import FlatLine, FlatMesh, LineKind, mesh_sheet, sheet_within, signed_area
from cosim.soft.geometry.named_mesh import BENDING_FACTOR, TIP_END, Crease, NamedMesh

FRONT, BACK, WELDED = "front", "back", "welded"
SheetName = Literal["both", "front", "back"]
_EDGES_TO_SEAM: Final = 4.0
_MOST_BY_DEFAULT: Final = 3000  # triangles of a sheet
_TIP_SHARE: Final = 0.05
_MORE_THAN_AN_EDGE: Final = 1.1
_LEAST_EXTENT: Final = 0.3
_WELDED_BENDING: Final = 4.0  # of each sheet: two sheets as one, twice as thick, bend 8 times as hard as one


@final
@dataclass(frozen=True)
class NodeChoice:
    """Nodes of a pattern in a named set.

    Args:
        name: of the set.
        lines: nodes on these, or within closed ones.
        box: lower left and upper right corner (2, 2) [m] of the drawing; None: use `lines`.
        sheet: of the nodes; those of seams are of both.
        pair: of sheets, from 1; None: all pairs.
        corners_only: only the corners of the lines, in their order: a cable's eyelets.
    """

    name: str
    lines: tuple[DrawnLine, ...] = ()
    box: Array | None = None
    sheet: SheetName = "both"
    pair: int | None = None
    corners_only: bool = False


@final
@dataclass(frozen=True)
class DrawnCrease:
    """A line of a pattern along which a sheet rests at an angle, see `Crease`."""

    line: DrawnLine
    sheet: SheetName
    turn_rad: float


@final
@dataclass(frozen=True)
class CutPattern:
    """Two sheets and how they are welded, in the drawing's coordinates.

    Args:
        cut: outlines of the sheets.
        holes: outlines of holes through them.
        seal: seams.
        ports: a line or point within each chamber.
        chambers: names of the chambers, in the order of their ports; none: there is one.
        folds: lines that become edges of the mesh.
        creases: those of them that rest at an angle.
        frames: closed lines along seams that stiffeners run along.
        sets: named nodes.
        seam_width_m: width of the welds, half of it on each side of a seam; 0: a line.
        mesh_m: length of an edge; None: a quarter of the largest distance to a seam.
        open_ends: whether chambers may be open at edges of the sheets, where caps close them.
        pairs: of sheets, one on the other; neighbours are joined along the holes that no seam closes, and
            caps close the first and the last hole.
        pair_height_m: from one pair to the next; of a single pair from hole to hole, or 0: it is flat.
    """

    cut: tuple[DrawnLine, ...]
    seal: tuple[DrawnLine, ...]
    ports: tuple[DrawnLine, ...]
    chambers: tuple[str, ...] = ()
    holes: tuple[DrawnLine, ...] = ()
    folds: tuple[DrawnLine, ...] = ()
    creases: tuple[DrawnCrease, ...] = ()
    frames: tuple[DrawnLine, ...] = ()
    sets: tuple[NodeChoice, ...] = ()
    seam_width_m: float = 0.0
    mesh_m: float | None = None
    open_ends: bool = False
    pairs: int = 1
    pair_height_m: float = 0.0


@final
@dataclass(frozen=True)
class Placing:
    """Position and direction of the drawing on the flange.

    Args:
        along: direction of the drawing that leads away from the base.
        upright: whether that is the flange's z axis, the sheets in its xz plane; otherwise the sheets lie
            in its xy plane, and that direction is its y axis.
        base: name of the set whose middle comes to the flange's origin.
        tip: name of the set at the free end.
        center: names of the sets that the centre line runs through before the tip.
    """

    along: Literal["+x", "-x", "+y", "-y"]
    upright: bool
    base: str
    tip: str
    center: tuple[str, ...]


@final
@dataclass(frozen=True)
class FlatFilm:
    """A pattern after meshing: the mesh of one sheet, its chambers and welds.

    Args:
        mesh: of one sheet.
        chamber: (m,) of each triangle, -1 where the sheets are welded flat.
        shared: (n,) whether both sheets of a pair have the node.
        joined: (n,) whether neighbouring pairs of sheets share the node: it is on an open hole of units.
        panel_m: width of the panels that the film wrinkles in: largest distance within a chamber between
            seams, or from a seam to the hole in the middle of units.
        sets: nodes of one sheet in each set, in order along the line where it is one.
        frames: nodes of each frame, in order around it.
    """

    mesh: FlatMesh
    chamber: IntArray
    shared: Mask
    joined: Mask
    panel_m: float
    sets: Mapping[str, IntArray] = field(default_factory=dict)
    frames: tuple[IntArray, ...] = ()


def flat_film(pattern: CutPattern, along: str = "+y") -> FlatFilm:
    """Return the mesh of a pattern's sheets, with the chambers that its ports lead into.

    Args:
        pattern: drawn.
        along: direction of the drawing that the mesh follows, so that a turned drawing gives the same film.

    Raises:
        MeshError: lines are open, cross themselves or lie outside the outline, a port is in no chamber, a
            seam does not close, or a set has no nodes. The message has the place in the drawing.
    """
    for line in (*pattern.cut, *pattern.holes, *pattern.seal, *pattern.folds, *pattern.frames):
        if np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum() < SAME_PLACE_M:
            raise MeshError(f"{line.where or 'a line'} at {in_mm(line.middle)} has no length: take it away")
    joined_lines = flat_mesh.with_ends_met([*pattern.cut, *pattern.holes, *pattern.seal])
    cut_end, holes_end = len(pattern.cut), len(pattern.cut) + len(pattern.holes)
    pattern = replace(
        pattern,
        cut=tuple(joined_lines[:cut_end]),
        holes=tuple(joined_lines[cut_end:holes_end]),
        seal=tuple(joined_lines[holes_end:]),
    )
    sheet = sheet_within((*pattern.cut, *pattern.holes))
    lines = _lines(pattern, sheet)
    for line in (*pattern.seal, *pattern.folds, *pattern.frames):
        flat_mesh.check_within(line, sheet)
    corners = [line.points for choice in pattern.sets if choice.corners_only for line in choice.lines]
    points = np.concatenate([np.zeros((0, 2)), *corners])
    edge_m = pattern.mesh_m or _edge_length(sheet, lines, pattern.ports)
    mesh = _meshed_along(along, pattern, points)
    for flat in lines:
        if flat.kind == LineKind.SEAL:
            _check_followed(flat.points, mesh, edge_m)
    chamber = _chambers(mesh, pattern)
    mesh, chamber = _without_dead_corners(mesh, chamber)
    shared = _shared(mesh, chamber)
    sets = {choice.name: _chosen(choice, mesh, edge_m) for choice in pattern.sets}
    joined = np.zeros(len(shared), dtype=bool)
    joined[mesh.edges_of(LineKind.HOLE)] = pattern.pair_height_m > 0.0
    frames = tuple(_around_frame(line, mesh, shared) for line in pattern.frames)
    if len({len(frame) for frame in frames}) > 1:
        raise MeshError(
            f"the frames have {', '.join(str(len(frame)) for frame in frames)} nodes; frames of one "
            "pattern have the same number: draw them alike"
        )
    joined &= ~shared
    if pattern.pair_height_m and not joined.any():
        raise MeshError("pair_height_m is set, but no hole is open: draw one in the middle, or omit it")
    return FlatFilm(mesh, chamber, shared, joined, _panel(mesh, chamber, joined), sets, frames)


def _meshed_along(along: str, pattern: CutPattern, points: Array) -> FlatMesh:
    """Return the mesh of a pattern's sheets, made with a direction of the drawing as +y."""

    def turned(lines: Sequence[DrawnLine]) -> tuple[DrawnLine, ...]:
        return tuple(replace(line, points=_turned(line.points, along)) for line in lines)

    kinds = ("cut", "holes", "seal", "folds", "frames", "ports")
    sets = tuple(replace(choice, lines=turned(choice.lines)) for choice in pattern.sets)
    changes: dict[str, Any] = {kind: turned(getattr(pattern, kind)) for kind in kinds}
    pattern = replace(pattern, sets=sets, **changes)
    sheet = sheet_within((*pattern.cut, *pattern.holes))
    lines = _lines(pattern, sheet)
    edge_m = pattern.mesh_m or _edge_length(sheet, lines, pattern.ports)
    mesh = mesh_sheet(sheet, lines, _turned(points, along), edge_m)
    return_direction = {"+x": "-x", "-x": "+x"}.get(along, along)
    return replace(mesh, positions=_turned(mesh.positions, return_direction))


def _lines(pattern: CutPattern, sheet: Any) -> list[FlatLine]:
    """Return the lines of a pattern that become edges."""
    lines = [FlatLine(line.points, LineKind.CUT) for line in pattern.cut]
    lines += [FlatLine(line.points, LineKind.HOLE) for line in pattern.holes]
    lines += [FlatLine(points, LineKind.SEAL) for points in _seams(pattern, sheet)]
    lines += [FlatLine(line.points, LineKind.FOLD) for line in pattern.folds]
    lines += [FlatLine(line.points, LineKind.OTHER) for line in pattern.frames]
    for choice in pattern.sets:
        if not choice.corners_only:
            lines += [FlatLine(line.points, LineKind.OTHER) for line in choice.lines if len(line.points) > 1]
    return lines


def _around_frame(line: DrawnLine, mesh: FlatMesh, shared: Mask) -> IntArray:
    """Return the nodes on a closed line, in order around it."""
    shapely = extra_module("shapely", "pattern")
    if not line.closed:
        raise MeshError(f"{line.where} is open at {in_mm(line.points[-1])}: a frame is a closed line")
    frame_line, node_points = shapely.LineString(line.points), shapely.points(mesh.positions)
    nodes = np.flatnonzero(shapely.distance(node_points, frame_line) < SAME_PLACE_M)
    chamber_nodes = nodes[~shared[nodes]]
    if len(chamber_nodes):
        raise MeshError(
            f"{line.where} is over a chamber at {in_mm(mesh.positions[chamber_nodes[0]])}: draw it "
            "along seams, where the sheets are one"
        )
    return nodes[np.argsort(shapely.line_locate_point(frame_line, node_points[nodes]), kind="stable")]


def _check_followed(seam: Array, mesh: FlatMesh, edge_m: float) -> None:
    """Refuse a mesh whose welded edges do not follow a seam (k, 2) all along."""
    shapely = extra_module("shapely", "pattern")
    seam_line = shapely.LineString(seam)
    distance_along_m = np.linspace(0.0, seam_line.length, 2 + int(4.0 * seam_line.length / edge_m))
    samples = shapely.line_interpolate_point(seam_line, distance_along_m)
    edges = shapely.MultiLineString(list(mesh.positions[mesh.edges_of(LineKind.SEAL)]))
    distance_m = shapely.distance(samples, edges)
    if distance_m.max() > 0.5 * edge_m:
        point = np.array(samples[int(np.argmax(distance_m))].coords[0])
        raise MeshError(f"the mesh does not follow the seam at {in_mm(point)}: set mesh_m to less")


def _seams(pattern: CutPattern, sheet: Any) -> list[Array]:
    """Return the seams' lines, or the outlines of their width."""
    shapely = extra_module("shapely", "pattern")
    for line in pattern.seal:
        flat_mesh.check_simple(line)
    if not pattern.seam_width_m:
        return [line.points for line in pattern.seal]
    center_lines = shapely.unary_union([shapely.LineString(line.points) for line in pattern.seal])
    widened_seams = shapely.intersection(
        center_lines.buffer(0.5 * pattern.seam_width_m, cap_style="flat"), sheet
    )
    for port in pattern.ports:
        if widened_seams.contains(shapely.Point(*port.middle)):
            raise MeshError(
                f"{port.where or 'the port'} at {in_mm(port.middle)} lies within a seam of "
                f"{1e3 * pattern.seam_width_m:g} mm: set seam_width_m to less, or move it"
            )
    polygons = getattr(widened_seams, "geoms", (widened_seams,))
    rings = [ring for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]
    return [np.array(ring.coords) for ring in rings]


def _edge_length(sheet: Any, lines: Sequence[FlatLine], ports: Sequence[DrawnLine]) -> float:
    """Return an edge length: a quarter of the largest distance from a seam; more if the area is large."""
    shapely = extra_module("shapely", "pattern")
    walls = [shapely.LineString(line.points) for line in lines if line.kind & (LineKind.SEAL | LineKind.CUT)]
    faces = shapely.polygonize([shapely.unary_union(walls, grid_size=1e-9)]).geoms
    marks = [shapely.Point(*port.middle) for port in ports]
    chamber_faces = [face for face in faces if any(face.contains(mark) for mark in marks)] or [sheet]
    depth = max(shapely.maximum_inscribed_circle(face).length for face in chamber_faces)
    return float(max(depth / _EDGES_TO_SEAM, math.sqrt(sheet.area / (0.433 * _MOST_BY_DEFAULT))))


def _neighbours(triangles: IntArray) -> dict[tuple[int, int], list[int]]:
    """Return the triangles at each edge, by its nodes, ascending."""
    owners: dict[tuple[int, int], list[int]] = {}
    for row, (a, b) in enumerate(np.sort(surface.directed_edges(triangles), axis=1).tolist()):
        owners.setdefault((a, b), []).append(row // 3)
    return owners


def _connected(mesh: FlatMesh, pattern: CutPattern) -> tuple[list[list[int]], dict[int, tuple[int, int]]]:
    """Return the triangles that gas reaches from each, and by triangle the edges where no other lies."""
    seams = {(a, b) for a, b in mesh.edges_of(LineKind.SEAL).tolist()}
    around = _neighbours(mesh.triangles)
    beside: list[list[int]] = [[] for _ in mesh.triangles]
    open_edges: dict[int, tuple[int, int]] = {}
    joints = {(a, b) for a, b in mesh.edges_of(LineKind.HOLE).tolist()} if pattern.pair_height_m else set()
    for edge, owners in around.items():
        if edge in seams:
            continue
        if len(owners) == 1 and edge in joints:
            continue
        if len(owners) == 1:
            open_edges[owners[0]] = edge
        else:
            beside[owners[0]].append(owners[1])
            beside[owners[1]].append(owners[0])
    return beside, open_edges


def _chambers(mesh: FlatMesh, pattern: CutPattern) -> IntArray:
    """Return the chamber (m,) that each triangle is in, by flood fill from the ports; -1 for none."""
    shapely, ports = extra_module("shapely", "pattern"), pattern.ports
    if not ports:
        raise MeshError("the pattern has no port: mark the inside of each chamber on layer PORT")
    beside, open_edges = _connected(mesh, pattern)
    chamber = np.full(len(mesh.triangles), -1)
    walls = shapely.MultiLineString(list(mesh.positions[mesh.edges_of(LineKind.SEAL)]))
    for number, port in enumerate(ports):
        if shapely.distance(shapely.Point(*port.middle), walls) < SAME_PLACE_M:
            raise MeshError(f"{port.where or 'the port'} at {in_mm(port.middle)} lies on a seam: move it off")
        first = _triangle_at(mesh, port)
        if chamber[first] >= 0:
            raise MeshError(
                f"{port.where or 'a port'} at {in_mm(port.middle)} leads into the chamber of "
                f"{ports[chamber[first]].where or 'another port'}: a chamber has one port"
            )
        queue = [first]
        chamber[first] = number
        while queue:
            triangle = queue.pop()
            if triangle in open_edges and not pattern.open_ends:
                middle = mesh.positions[list(open_edges[triangle])].mean(axis=0)
                raise MeshError(
                    f"the chamber of {port.where or 'the port'} is open at {in_mm(middle)}: no seam closes "
                    "it there; draw it on layer SEAL; if all edges are welded, set body.edge = 'sealed' "
                    "(commands that read a drawing: --sealed)"
                )
            for neighbour in beside[triangle]:
                if chamber[neighbour] < 0:
                    chamber[neighbour] = number
                    queue.append(neighbour)
    return chamber


def _triangle_at(mesh: FlatMesh, port: DrawnLine) -> int:
    """Return the triangle that a port lies in."""
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    point = port.middle

    def turn(p: Array, q: Array) -> Array:
        return np.asarray((q - p)[:, 0] * (point - p)[:, 1] - (q - p)[:, 1] * (point - p)[:, 0])

    inside = np.minimum.reduce([turn(a, b), turn(b, c), turn(c, a)])
    best = int(np.argmax(inside))
    if inside[best] < 0.0:
        raise MeshError(
            f"{port.where or 'the port'} at {in_mm(point)} is outside the sheet: move it inside layer CUT"
        )
    return best


def _without_dead_corners(mesh: FlatMesh, chamber: IntArray) -> tuple[FlatMesh, IntArray]:
    """Return the mesh with edges of a chamber from seam to seam cut in the middle, and the chambers.

    Such an edge would weld the sheets where they are not, as in a corner that one triangle fills.
    """
    x, triangles = mesh.positions, mesh.triangles
    on_line = {(a, b) for a, b in mesh.edges_of(LineKind.SEAL).tolist()}
    for _ in range(64):
        shared = _shared(FlatMesh(x, triangles, mesh.edges, mesh.kinds), chamber)
        around = _neighbours(triangles)
        dead = [
            edge
            for edge, owners in around.items()
            if shared[list(edge)].all() and edge not in on_line and chamber[owners[0]] >= 0
        ]
        if not dead:
            break
        length = {edge: float(np.linalg.norm(x[edge[1]] - x[edge[0]])) for edge in dead}
        cut_triangles: set[int] = set()
        for edge in sorted(dead, key=lambda edge: (-round(length[edge], 9), edge)):
            if cut_triangles.isdisjoint(around[edge]):
                cut_triangles.update(around[edge])
                x, triangles, chamber = _with_cut_edge(x, triangles, chamber, edge, around[edge])
    return FlatMesh(x, triangles, mesh.edges, mesh.kinds), chamber


def _with_cut_edge(
    x: Array, triangles: IntArray, chamber: IntArray, edge: tuple[int, int], owners: Sequence[int]
) -> tuple[Array, IntArray, IntArray]:
    new = len(x)
    x = np.concatenate([x, x[list(edge)].mean(axis=0)[None]])
    triangles = np.array(triangles)
    for owner in owners:
        first, second = triangles[owner].copy(), triangles[owner].copy()
        first[first == edge[0]] = new
        second[second == edge[1]] = new
        triangles[owner] = first
        triangles = np.concatenate([triangles, second[None]])
        chamber = np.concatenate([chamber, chamber[[owner]]])
    return x, triangles, chamber


def _shared(mesh: FlatMesh, chamber: IntArray) -> Mask:
    """Return which nodes (n,) both sheets have: those of seams, and of areas that are welded flat."""
    shared = np.zeros(len(mesh.positions), dtype=bool)
    shared[mesh.edges_of(LineKind.SEAL)] = True
    shared[mesh.triangles[chamber < 0]] = True
    return shared


def _panel(mesh: FlatMesh, chamber: IntArray, joined: Mask) -> float:
    """Return the width [m] of the panels that wrinkle, see `FlatFilm`."""
    shapely = extra_module("shapely", "pattern")
    seams = shapely.MultiLineString(list(mesh.positions[mesh.edges_of(LineKind.SEAL)]))
    seam_distance_m = np.zeros(len(mesh.positions))
    nodes = np.unique(mesh.triangles[chamber >= 0])
    seam_distance_m[nodes] = shapely.distance(shapely.points(mesh.positions[nodes]), seams)
    at_hole = (
        seam_distance_m[mesh.edges_of(LineKind.HOLE)].max(initial=0.0) > seam_distance_m.max() - SAME_PLACE_M
    )
    return float(seam_distance_m.max()) if at_hole or joined.any() else 2.0 * float(seam_distance_m.max())


def _chosen(choice: NodeChoice, mesh: FlatMesh, edge_m: float) -> IntArray:
    """Return the nodes of one sheet that a set has."""
    shapely = extra_module("shapely", "pattern")
    x = mesh.positions
    if choice.box is not None:
        low, high = np.sort(choice.box, axis=0)
        nodes = np.flatnonzero(((x >= low - SAME_PLACE_M) & (x <= high + SAME_PLACE_M)).all(axis=1))
        if not len(nodes):
            raise MeshError(f"set '{choice.name}': no node is in the box from {in_mm(low)} to {in_mm(high)}")
        return nodes
    if choice.corners_only:
        corners = np.concatenate([line.points for line in choice.lines])
        distance_m = np.linalg.norm(x[None] - corners[:, None], axis=2)
        if distance_m.min(axis=1).max() > SAME_PLACE_M:
            missed_corner = corners[np.argmax(distance_m.min(axis=1))]
            raise MeshError(f"set '{choice.name}': {in_mm(missed_corner)} is outside the sheet")
        return np.asarray(distance_m.argmin(axis=1))
    node_points, is_near = shapely.points(x), np.zeros(len(x), dtype=bool)
    for line in choice.lines:
        shape = shapely.Polygon(line.points) if line.closed else shapely.LineString(line.points)
        is_near |= shapely.distance(node_points, shape) < SAME_PLACE_M
    if not is_near.any():
        raise MeshError(f"set '{choice.name}': its lines are outside the sheet")
    nodes = np.flatnonzero(is_near)
    open_lines = [shapely.LineString(line.points) for line in choice.lines if not line.closed]
    if len(open_lines) == 1 and len(choice.lines) == 1:
        nodes = nodes[np.argsort(shapely.line_locate_point(open_lines[0], node_points[nodes]), kind="stable")]
    return nodes


def inflatable(film: FlatFilm, pattern: CutPattern, placing: Placing) -> NamedMesh:
    """Return the sheets of a pattern as a film in the flange's frame; a single pair is flat.

    Args:
        film: of the pattern.
        pattern: drawn.
        placing: on the flange.

    Raises:
        MeshError: a set has no nodes of its sheet.
    """
    origin = _turned(film.mesh.positions[film.sets[placing.base]].mean(axis=0)[None], placing.along)[0]
    flat = _turned(film.mesh.positions, placing.along) - origin
    sheets, count = _numbered(film, pattern.pairs)
    positions, rise = np.zeros((count, 3)), _rise(film)
    for pair, (back, front) in enumerate(sheets):
        for nodes, sheet_side in ((back, -0.5), (front, 0.5)):
            height = pattern.pair_height_m * (pair + 0.5 + sheet_side * rise)
            columns = (flat[:, 0], -height, flat[:, 1]) if placing.upright else (*flat.T, height)
            positions[nodes] = np.stack(columns, axis=1)
    sheet, m = film.mesh.triangles, len(film.mesh.triangles)
    triangles = np.concatenate(
        [faces for back, front in sheets for faces in (front[sheet], back[sheet][:, ::-1])]
    )
    index = np.arange(len(triangles)).reshape(pattern.pairs, 2, m)
    welded = index[:, :, film.chamber < 0].ravel()
    bending = np.where(np.isin(index.ravel(), welded), _WELDED_BENDING, 1.0)
    caps = surface.rims(triangles)
    sets = {
        choice.name: _as_cap(_on_sheets(film.sets[choice.name], choice, flat, sheets), caps)
        for choice in pattern.sets
    }
    ends = _tip_end(film, placing, flat) if len(placing.center) == 1 else np.zeros(0, np.int64)
    if len(ends):
        sets[TIP_END] = np.unique(np.concatenate([nodes[ends] for pair in sheets for nodes in pair]))
    frames = {f"frame_{number}": sheets[0][0][nodes] for number, nodes in enumerate(film.frames, start=1)}
    groups = {FRONT: index[:, 0].ravel(), BACK: index[:, 1].ravel(), WELDED: welded}
    for number, name in enumerate(pattern.chambers):  # welded film has no gas: any chamber may have it
        groups[name] = index[:, :, film.chamber.clip(0) == number].ravel()
    return NamedMesh(
        positions=positions,
        triangles=triangles,
        rings={**sets, **frames},
        seam_rings=tuple(frames),
        caps=caps,
        base_ring=placing.base,
        tip_ring=placing.tip,
        center_rings=placing.center,
        lines={name: nodes for name, nodes in sets.items() if name != TIP_END},
        face_groups=groups,
        face_values={"wrinkle_panel_m": np.full(len(triangles), film.panel_m), BENDING_FACTOR: bending},
        sheets=(FRONT, BACK),
        chambers=pattern.chambers,
        creases=tuple(_placed(crease, placing, origin) for crease in pattern.creases),
        tip_along=np.array([0.0, not placing.upright, placing.upright], float) if len(ends) else None,
    )


def _tip_end(film: FlatFilm, placing: Placing, flat: Array) -> IntArray:
    """Return the nodes of one sheet whose film gives the direction of a tip that is a line.

    They are within a twentieth of the way from base to tip of the tip's nodes, or within a row of triangles
    where that is longer.
    """
    tip, base = (flat[film.sets[name]] for name in (placing.tip, placing.base))
    sides = flat[film.mesh.triangles] - flat[np.roll(film.mesh.triangles, 1, axis=1)]
    row = _MORE_THAN_AN_EDGE * float(np.median(np.linalg.norm(sides, axis=2)))
    within = max(_TIP_SHARE * float(np.linalg.norm(tip.mean(axis=0) - base.mean(axis=0))), row)
    ends = np.flatnonzero(scipy.spatial.cKDTree(tip).query(flat)[0] <= within)
    has_length = np.ptp(flat[ends, 1]) >= _LEAST_EXTENT * within
    return ends if has_length else np.zeros(0, np.int64)


def _as_cap(nodes: IntArray, caps: Sequence[IntArray]) -> IntArray:
    """Return the cap with these nodes, in its order; the nodes themselves if no cap has them."""
    return next((cap for cap in caps if set(cap.tolist()) == set(nodes.tolist())), nodes)


def _placed(crease: DrawnCrease, placing: Placing, origin: Array) -> Crease:
    """Return a crease of a single, flat pair in the flange's frame."""
    flat, points = _turned(crease.line.points, placing.along) - origin, np.zeros((len(crease.line.points), 3))
    points[:, [0, 2] if placing.upright else [0, 1]] = flat
    return Crease(points, None if crease.sheet == "both" else crease.sheet, crease.turn_rad)


def _numbered(film: FlatFilm, pairs: int) -> tuple[list[tuple[IntArray, IntArray]], int]:
    """Return the nodes (n,) of the back and the front sheet of each pair, and how many nodes there are."""
    sheets: list[tuple[IntArray, IntArray]] = []
    count = 0
    for pair in range(pairs):
        is_new = ~film.joined if pair else np.ones(len(film.shared), dtype=bool)
        back = count - 1 + np.cumsum(is_new)
        if pair:
            back = np.where(film.joined, sheets[-1][1], back)
        count += int(is_new.sum())
        front = np.where(film.shared, back, count - 1 + np.cumsum(~film.shared))
        count += int((~film.shared).sum())
        sheets.append((back, front))
    return sheets, count


def _rise(film: FlatFilm) -> Array:
    """Return how far (n,) each node is from the middle of its pair: 0 at seams, 1 at joining holes."""
    if not film.joined.any():
        return np.zeros(len(film.shared))
    x = film.mesh.positions
    seam, hole = (scipy.spatial.cKDTree(x[nodes]).query(x)[0] for nodes in (film.shared, film.joined))
    return np.asarray(seam / (seam + hole))


def _turned(points: Array, along: str) -> Array:
    """Return points (n, 2) turned so that a direction of the drawing is +y."""
    x, y = points.T
    turned = {"+y": (x, y), "-y": (-x, -y), "+x": (-y, x), "-x": (y, -x)}[along]
    return np.stack(turned, axis=1)


def _on_sheets(
    nodes: IntArray, choice: NodeChoice, flat: Array, sheets: Sequence[tuple[IntArray, IntArray]]
) -> IntArray:
    """Return the nodes of a set on its sheets; of both, along the front and back along the back."""
    ordered = choice.corners_only or any(not line.closed for line in choice.lines)
    if choice.sheet != "both" and not ordered:
        nodes = _around(nodes, flat)
    elif not ordered:
        nodes = nodes[np.lexsort((flat[nodes, 1], flat[nodes, 0]))]
    on_sheets = np.zeros(0, np.int64)
    for back, front in sheets if choice.pair is None else [sheets[choice.pair - 1]]:
        nodes_of_sheets = {FRONT: (front[nodes],), BACK: (back[nodes],)}.get(
            choice.sheet, (front[nodes], back[nodes][::-1])
        )
        for sheet_nodes in nodes_of_sheets:
            on_sheets = np.concatenate([on_sheets, sheet_nodes[~np.isin(sheet_nodes, on_sheets)]])
    return on_sheets


def _around(nodes: IntArray, flat: Array) -> IntArray:
    """Return nodes counter-clockwise around their mean."""
    from_mean = flat[nodes] - flat[nodes].mean(axis=0)
    return nodes[np.argsort(np.arctan2(from_mean[:, 1], from_mean[:, 0]), kind="stable")]


def film_area(film: FlatFilm, chamber: int) -> float:
    """Return the flat area [m^2] of a chamber, or with -1 that of the film that is welded flat."""
    areas = signed_area(film.mesh.positions, film.mesh.triangles)
    return float(areas[film.chamber == chamber].sum())
