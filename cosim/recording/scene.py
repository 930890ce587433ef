"""The three-dimensional part of a recording, and rows of many ticks as columns of its components.

Columns come straight from arrays: an archetype's `columns` looks at every field that it has.

Lines of many frames are one array: converting them one by one would cost more than all the rest.

Sharp edges of the drawn shape, drawn as lines so that an evenly coloured film keeps its form.

Rigid bodies as lit meshes.

Weight and flange wrench as arrows with their sizes written beside them.

The tip's path and the point it is sent to.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final, TypeAlias, final

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import components
from rerun.components import ColorBatch, LineStrip3DBatch

from cosim.base.frames import Array, IntArray, cross
from cosim.base.solid import BodyShape
from cosim.recording import colours
from cosim.recording.blueprint import FOLLOW, TICKS, TIMELINE, TIP_PATH, Eye, close_eye, soft_size
from cosim.recording.colours import WHITE, Colour
from cosim.recording.plots import Plot
from cosim.soft.geometry.surface import dihedral_angle, interior_hinges
from cosim.telemetry.snapshot import DrawnFilm, RunInfo, Snapshot
from cosim.telemetry.tick_batch import TickBatch


def column(archetype: Any, field: str, batch: Any, lengths: IntArray | None = None) -> rr.ComponentColumn:
    """Return a column of one component.

    Args:
        archetype: such as `rr.Mesh3D`.
        field: of the archetype, such as "vertex_positions".
        batch: the component's values in all rows, such as `rr.components.Position3DBatch(...)`.
        lengths: values of each row; None: one.
    """
    name = f"{archetype.archetype_short_name()}:{field}"
    kind = rr.ComponentDescriptor(
        name, component_type=batch.component_type(), archetype=archetype.archetype()
    )
    return rr.ComponentColumn(kind, batch, lengths=lengths)


def time_columns(ticks: IntArray, tick_ns: int) -> list[rr.TimeColumn]:
    """Return both timelines of some ticks; whole nanoseconds, because rounded seconds would not join.

    Args:
        ticks: (n,), rising.
        tick_ns: length of a tick [ns].
    """
    duration = (ticks * tick_ns).astype("timedelta64[ns]")
    return [rr.TimeColumn(TIMELINE, duration=duration), rr.TimeColumn(TICKS, sequence=ticks)]


@final
class PlotBuffer:
    """Values of all plots, one row per tick.

    Args:
        stream: to write to.
        plots: whose values are taken.
        tick_ns: length of a tick [ns].
    """

    def __init__(self, stream: rr.RecordingStream, plots: Sequence[Plot], tick_ns: int) -> None:
        self._stream = stream
        self._plots = plots
        self._tick_ns = tick_ns
        self._ticks: list[IntArray] = []
        self._values: list[Array] = []
        self._styled: set[str] = set()

    def append(self, batch: TickBatch) -> None:
        """Take the values of some ticks."""
        columns = [plot.values(batch).reshape(len(batch), len(plot.series)) for plot in self._plots]
        self._values.append(np.concatenate(columns, axis=1))
        self._ticks.append(batch.tick)

    def flush(self) -> None:
        """Write what was gathered."""
        if not self._values:
            return
        values, ticks = np.concatenate(self._values), np.concatenate(self._ticks)
        times = time_columns(ticks, self._tick_ns)
        start = 0
        for plot in self._plots:
            stop = start + len(plot.series)
            own = values[:, start:stop]
            kept = ~np.isnan(own).any(axis=1)
            if kept.all():
                self._send(plot, times, own)
            elif kept.any():
                self._send(plot, time_columns(ticks[kept], self._tick_ns), own[kept])
            start = stop
        self._values.clear()
        self._ticks.clear()

    def mark(self, entity: str, name: str, ticks: IntArray, values: Array) -> None:
        """Write a curve of single points (k,) at some ticks (k,), in the unit of the plot that it joins."""
        path = f"/plots/{entity}"
        self._stream.log(path, rr.SeriesPoints(names=name, colors=WHITE, marker_sizes=6.0), static=True)
        times = time_columns(ticks, self._tick_ns)
        self._stream.send_columns(path, times, rr.Scalars.columns(scalars=values))

    def _send(self, plot: Plot, times: Sequence[rr.TimeColumn], values: Array) -> None:
        path = f"/plots/{plot.entity}"
        if path not in self._styled:  # a curve that never gets a point must not appear in the legend
            self._styled.add(path)
            widths = [2.0] * len(plot.series)
            policy = rr.components.AggregationPolicy.Max if plot.peaks else None
            style = rr.SeriesLines(
                colors=plot.colours, names=plot.series, widths=widths, aggregation_policy=policy
            )
            self._stream.log(path, style, static=True)
        each = np.full(len(values), values.shape[1])
        scalars = column(rr.Scalars, "scalars", rr.components.ScalarBatch(values.ravel()), each)
        self._stream.send_columns(path, times, [scalars])


Points: TypeAlias = NDArray[np.floating[Any]]


def strip_array(points: Points, lengths: IntArray) -> Any:
    """Return an Arrow list array of lines that lie one after the other in one array of points.

    Args:
        points: (k, 3) [m].
        lengths: points of each line; they sum to k.
    """
    empty = LineStrip3DBatch([]).as_arrow_array()
    values = rr.encodings.Vec3DBatch(np.ascontiguousarray(points, dtype=np.float32)).as_arrow_array()
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return empty.from_arrays(offsets, values, type=empty.type)


def style_lines(stream: rr.RecordingStream, path: str, radius_m: float, colour: Colour | None = None) -> None:
    """Log once what all lines of an entity have in common.

    Args:
        stream: to write to.
        path: of the entity.
        radius_m: of all lines [m].
        colour: of all lines; None where they differ.
    """
    colours = None if colour is None else [colour]
    stream.log(path, rr.LineStrips3D.from_fields(colors=colours, radii=[radius_m]), static=True)


def send_lines(
    stream: rr.RecordingStream,
    path: str,
    times: Sequence[rr.TimeColumn],
    points: Points,
    lengths: IntArray,
    lines_per_frame: IntArray,
    colours: NDArray[np.uint8] | None = None,
) -> None:
    """Write lines, any number per frame.

    Args:
        stream: to write to.
        path: of the entity.
        times: time columns, one row per frame.
        points: (k, 3) [m], of all lines of all frames.
        lengths: points of each line.
        lines_per_frame: (frames,).
        colours: (lines, 3), of each line; None where they are styled alike.
    """
    strips = LineStrip3DBatch(strip_array(points, lengths))
    columns = [column(rr.LineStrips3D, "strips", strips, lines_per_frame)]
    if colours is not None:
        red, green, blue = colours.astype(np.uint32).T
        packed = (red << 24) | (green << 16) | (blue << 8) | np.uint32(0xFF)
        columns.append(column(rr.LineStrips3D, "colors", ColorBatch(packed), lines_per_frame))
    stream.send_columns(path, times, columns)


def crease_lines(positions: Array, triangles: IntArray) -> list[IntArray]:
    """Return the edges that fold outward by less than a right angle, joined into lines.

    On a drawn chamber these are the welds between its films.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3) node indices, outward orientation.

    Returns:
        Node indices of each line; closed lines end with their first node.
    """
    hinges = interior_hinges(triangles)
    edges = hinges[dihedral_angle(positions, hinges) < 0.5 * np.pi, 1:3]
    neighbours: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    # Open lines first, from their ends; what is left then are closed ones.
    starts = sorted(neighbours, key=lambda node: len(neighbours[node]) == 2)
    lines = (_walk(start, neighbours) for start in starts)
    return [np.array(line) for line in lines if len(line) > 1]


def _walk(start: int, neighbours: dict[int, list[int]]) -> list[int]:
    """Follow edges from a node as far as they go, and use them up."""
    line = [start]
    while neighbours[line[-1]]:
        here, there = line[-1], neighbours[line[-1]].pop()
        neighbours[there].remove(here)
        line.append(there)
    return line


FLOOR_NAME: Final = "floor"
_SHARP: Final = float(np.cos(np.radians(35.0)))


def body_path(name: str) -> str:
    """Return the entity of a rigid body."""
    return f"/world/rigid/{rr.escape_entity_path_part(name)}"


def log_rigid_meshes(stream: rr.RecordingStream, stage: RunInfo) -> None:
    """Log the shapes of all bodies below their entities, which are moved."""
    count: Counter[int] = Counter()
    for shape in stage.shapes:
        name = stage.body_names[shape.body]
        stream.log(f"{body_path(name)}/{count[shape.body]}", rigid_mesh(shape, name), static=True)
        count[shape.body] += 1


def rigid_mesh(shape: BodyShape, body: str) -> rr.Mesh3D:
    """Return a mesh with normals, smooth over curved faces and sharp at edges.

    Args:
        shape: what is drawn.
        body: its body's name; the floor is darkened, so that it stays behind what stands on it.
    """
    corners = shape.vertices[shape.triangles].reshape(-1, 3)
    shade = (*colours.FLOOR_SHADE, 1.0) if body == FLOOR_NAME else (1.0, 1.0, 1.0, 1.0)
    return rr.Mesh3D(
        vertex_positions=corners.astype(np.float32),
        vertex_normals=corner_normals(shape.vertices, shape.triangles).astype(np.float32),
        triangle_indices=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        albedo_factor=[round(255 * part * factor) for part, factor in zip(shape.rgba, shade, strict=True)],
    )


def corner_normals(vertices: Array, triangles: IntArray) -> Array:
    """Return a normal for each corner of each triangle.

    The area-weighted mean over those triangles at the corner's vertex that turn less than 35 degrees
    away from the corner's own.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3) node indices.

    Returns:
        (3 m, 3), unit length; zero for triangles without area.
    """
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = np.ascontiguousarray(cross(b - a, c - a).T)
    face = area / np.maximum(np.sqrt((area * area).sum(axis=0)), 1e-30)
    corner, neighbour = _corners_that_meet(triangles.ravel())
    one, other = corner // 3, neighbour // 3
    near = sum(axis[one] * axis[other] for axis in face) > _SHARP
    corner, other = corner[near], other[near]
    normals = np.stack([np.bincount(corner, axis[other], 3 * len(triangles)) for axis in area])
    return np.asarray((normals / np.maximum(np.sqrt((normals * normals).sum(axis=0)), 1e-30)).T)


def _corners_that_meet(vertex: IntArray) -> tuple[IntArray, IntArray]:
    """Return all pairs of corners at one vertex, each with itself too: two arrays of corners."""
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex)
    first = np.cumsum(count) - count  # of each vertex in `order`
    many = count[vertex[order]]
    place = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many - first[vertex[order]], many)
    return np.repeat(order, many), order[place]


_WEIGHT_ARROW: Final = 0.33
"""Length of the weight's arrow over the size of the soft robot; all forces share its scale."""
_ARC_RADIUS: Final = 0.3
"""Radius of a torque's arc over the size of the soft robot."""
_ARC_AT_REFERENCE: Final = np.radians(270.0)
"""Angle of the arc of a torque of weight times half the size of the soft robot."""
_ARC_LONGEST: Final = np.radians(330.0)
_ARC_POINTS: Final = 20
_HEAD: Final = 3
"""Points of the arc that its arrow head replaces."""
_SMALLEST_ARC: Final = np.radians(8.0)
_SMALLEST_ARROW_M: Final = 4e-3
_RADIUS_M: Final = 2.2e-3


@final
class LoadArrows:
    """Draws the soft robot's weight and the wrench that it exerts on the flange.

    The force ends at the flange with its head, the torque turns about it. Arrows inside film or
    wrist would not be seen, so all are moved towards the camera.

    Args:
        stream: to write to.
        stage: what is run.
        size_m: of the soft robot [m].
        eye: camera from which they are to be seen.
    """

    def __init__(self, stream: rr.RecordingStream, stage: RunInfo, size_m: float, eye: Eye) -> None:
        self._stream = stream
        self._weight_N = stage.soft_weight_N
        self._down = stage.gravity / max(float(np.linalg.norm(stage.gravity)), 1e-30)
        self._metres_per_N = _WEIGHT_ARROW * size_m / max(stage.soft_weight_N, 1.0)
        self._radians_per_Nm = _ARC_AT_REFERENCE / (0.5 * size_m * max(stage.soft_weight_N, 1.0))
        self._arc_radius = _ARC_RADIUS * size_m
        self._towards_eye = eye.direction
        self._before_film = 0.2 * size_m * eye.direction
        self._before_wrist = 0.3 * size_m * eye.direction
        self._beside = 0.27 * size_m * eye.left
        self._log_styles()

    def send(self, frames: TickBatch, centre: Array, times: Sequence[rr.TimeColumn]) -> None:
        """Write frames.

        Args:
            frames: in the order of time.
            centre: (frames, 3) [m], of the film.
            times: time columns of the same length.
        """
        force, torque = frames.flange_force, frames.flange_torque
        flange, centre = frames.flange_position + self._before_wrist, centre + self._before_film
        weight = np.tile(self._metres_per_N * self._weight_N * self._down, (len(frames), 1))
        pull = self._metres_per_N * force
        self._send_arrows("weight", centre, weight, times)
        self._send_labels("weight", centre + weight + self._beside, None, times)
        self._send_arrows("flange_force", flange - pull, pull, times)
        sizes = zip(np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1), strict=True)
        texts = [f"on flange\n{newton:.1f} N\n{moment:.2f} N m" for newton, moment in sizes]
        self._send_labels("flange_force", flange - 0.6 * pull + self._beside, texts, times)
        self._send_arcs(flange, torque, times)

    def _log_styles(self) -> None:
        """Log once what does not change: colours, radii and the weight's label."""
        arrows = (
            ("weight", colours.WHITE),
            ("flange_force", colours.VERMILION),
            ("flange_torque/head", colours.SKY),
        )
        for name, colour in arrows:
            style = rr.Arrows3D.from_fields(colors=[colour], radii=[_RADIUS_M])
            self._stream.log(f"/world/loads/{name}", style, static=True)
        for name, labels in (("weight", [f"weight {self._weight_N:.1f} N"]), ("flange_force", None)):
            label = rr.Points3D.from_fields(colors=[colours.WHITE], radii=[1e-4], labels=labels)
            self._stream.log(f"/world/loads/{name}/label", label, static=True)
        style_lines(self._stream, "/world/loads/flange_torque", _RADIUS_M, colours.SKY)

    def _send_arrows(self, name: str, origins: Array, vectors: Array, times: Sequence[rr.TimeColumn]) -> None:
        # Without length an arrow has no direction to be drawn in.
        shown = np.linalg.norm(vectors, axis=1) > _SMALLEST_ARROW_M
        columns = _arrows(origins[shown], vectors[shown], shown.astype(np.int64))
        self._stream.send_columns(f"/world/loads/{name}", times, columns)

    def _send_labels(
        self, name: str, places: Array, texts: list[str] | None, times: Sequence[rr.TimeColumn]
    ) -> None:
        columns = [column(rr.Points3D, "positions", components.Position3DBatch(places))]
        if texts is not None:
            columns.append(column(rr.Points3D, "labels", components.TextBatch(texts)))
        self._stream.send_columns(f"/world/loads/{name}/label", times, columns)

    def _send_arcs(self, centres: Array, torque: Array, times: Sequence[rr.TimeColumn]) -> None:
        """Draw each torque as an arc that turns about it, with an arrow head."""
        size = np.linalg.norm(torque, axis=1)
        angle = np.minimum(self._radians_per_Nm * size, _ARC_LONGEST)
        shown = angle > _SMALLEST_ARC
        rows = shown.astype(int)
        axis = torque[shown] / size[shown, None]
        # The arc begins where it is farthest from the line of sight, so that it opens to the camera.
        across = np.cross(axis, self._towards_eye)
        across[np.linalg.norm(across, axis=1) < 0.3] = (0.0, 0.0, 1.0)
        first = across - np.einsum("fa,fa->f", across, axis)[:, None] * axis
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(axis, first)
        turn = (np.linspace(0.0, 1.0, _ARC_POINTS) * angle[shown, None])[:, :, None]
        circle = np.cos(turn) * first[:, None] + np.sin(turn) * second[:, None]
        points = centres[shown, None] + self._arc_radius * circle
        drawn = points[:, :-_HEAD]
        send_lines(
            self._stream, "/world/loads/flange_torque", times, drawn.reshape(-1, 3),
            np.full(len(drawn), drawn.shape[1]), rows,
        )  # fmt: skip
        tail = points[:, -_HEAD - 1]
        heads = _arrows(tail, points[:, -1] - tail, rows)
        self._stream.send_columns("/world/loads/flange_torque/head", times, heads)


def _arrows(origins: Array, vectors: Array, rows: IntArray) -> list[rr.ComponentColumn]:
    """Return the columns of arrows, so many in each row."""
    return [
        column(rr.Arrows3D, "origins", components.Position3DBatch(origins), rows),
        column(rr.Arrows3D, "vectors", components.Vector3DBatch(vectors), rows),
    ]


_TARGET: Final = "/world/target"
_CROSS_M: Final = 0.06
_CROSS_RADIUS_M: Final = 1.3e-3
_PATH_RADIUS_M: Final = 8e-4


@final
class TipMarks:
    """Draws the path as one step per frame, which the viewer joins, and the target as a cross.

    Args:
        stream: to write to.
        start: (3,) [m], tip before the first frame.
    """

    def __init__(self, stream: rr.RecordingStream, start: Array) -> None:
        self._stream = stream
        self._tip = start
        style_lines(stream, TIP_PATH, _PATH_RADIUS_M, colours.PINK)
        style_lines(stream, _TARGET, _CROSS_RADIUS_M, colours.GREEN)
        label = rr.Points3D.from_fields(colors=[colours.GREEN], radii=[1e-4], labels=["target"])
        stream.log(f"{_TARGET}/label", label, static=True)

    def send(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> None:
        """Write frames; `times` has as many rows."""
        tips = np.concatenate([self._tip[None], frames.tip_position])
        self._tip = tips[-1]
        steps = np.stack([tips[:-1], tips[1:]], axis=1)
        ones = np.ones(len(frames), dtype=np.int64)
        send_lines(self._stream, TIP_PATH, times, steps.reshape(-1, 3), 2 * ones, ones)
        given = frames.has_tip_target
        target, tip = frames.tip_target[given], frames.tip_position[given]
        # where a component is free (not a number), the tip's own
        self._send_targets(np.where(np.isnan(target), tip, target), given.astype(np.int64), times)

    def _send_targets(self, targets: Array, rows: IntArray, times: Sequence[rr.TimeColumn]) -> None:
        """Write targets (m, 3) [m], so many in each row."""
        arms = 0.5 * _CROSS_M * np.stack([-np.eye(3), np.eye(3)], axis=1)
        points = (targets[:, None, None] + arms).reshape(-1, 3)
        send_lines(self._stream, _TARGET, times, points, np.full(3 * len(targets), 2), 3 * rows)
        below = components.Position3DBatch(targets - (0.0, 0.0, 0.5 * _CROSS_M))
        columns = [column(rr.Points3D, "positions", below, rows)]
        self._stream.send_columns(f"{_TARGET}/label", times, columns)


Single: TypeAlias = NDArray[np.float32]

_SEAM: Final = (12, 14, 20)
_SEAM_RADIUS_M: Final = 5e-4
_CABLE_RADIUS_M: Final = 1.2e-3
_FOLLOWED: Final = 0.38
"""Where the close camera looks, from flange (0) to tip (1)."""
_AT_ONCE: Final = 64
"""Frames that are coloured together: few enough to stay in the processor's cache."""
_HALF_TAUT_N: Final = 1.0
"""Tension at which a cable's colour is halfway between slack and taut."""


@final
class Scene:
    """Logs where the bodies are, and everything that is drawn of the soft robot.

    Args:
        stream: to write to.
        stage: what is run.
        first: the first snapshot; its shape shows where the film is welded.
    """

    def __init__(self, stream: rr.RecordingStream, stage: RunInfo, first: Snapshot) -> None:
        self._stream = stream
        self._stage = stage
        positions = first.node_position
        given = stage.soft_triangles, stage.cables, stage.membrane_stress
        self._film = stage.drawn or DrawnFilm(np.arange(len(positions)), *given)
        nodes = len(self._film.nodes)
        self._share = np.full(nodes, 1.0 / nodes)
        # a copy: kernels take no array that is read-only
        self._colours = colours.MembraneColours(self._film.triangles.copy(), nodes)
        self._seams = crease_lines(positions[self._film.nodes], self._film.triangles)
        self._paths = [body_path(name) for name in stage.body_names]
        self._drawn = sorted({shape.body for shape in stage.shapes})
        size = soft_size(stage, first)
        self._loads = LoadArrows(stream, stage, size, close_eye(stage, first))
        self._tip = TipMarks(stream, first.tip_position)
        self._log_static()

    def go_on(self, last: Snapshot) -> None:
        """Let the path of the tip continue from where it was."""
        self._tip = TipMarks(self._stream, last.tip_position)

    def send(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> None:
        """Write frames.

        Args:
            frames: in the order of time.
            times: time columns of the same length.
        """
        self._send_bodies(frames, times)
        positions, centre = self._send_film(frames, times)
        self._send_node_lines("seams", positions, self._seams, times)
        self._send_cables(frames, positions, times)
        self._loads.send(frames, centre, times)
        self._tip.send(frames, times)

    def _log_static(self) -> None:
        log = self._stream.log
        log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if self._seams:
            style_lines(self._stream, "/world/soft/seams", _SEAM_RADIUS_M, _SEAM)
        if self._film.cables:
            style_lines(self._stream, "/world/soft/cables", _CABLE_RADIUS_M)
        # Vertex data would shadow the frames if it were static: indices alone.
        indices = self._film.triangles.astype(np.uint32)
        log("/world/soft/film", rr.Mesh3D.from_fields(triangle_indices=indices), static=True)

    def _send_bodies(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> None:
        positions = frames.body_position
        quaternions = frames.body_quaternion[..., [1, 2, 3, 0]]
        for body in self._drawn:
            there = column(rr.Transform3D, "translation", components.Translation3DBatch(positions[:, body]))
            turned = column(rr.Transform3D, "quaternion", components.RotationQuatBatch(quaternions[:, body]))
            self._stream.send_columns(self._paths[body], times, [there, turned])
        seen = frames.flange_position + _FOLLOWED * (frames.tip_position - frames.flange_position)
        followed = column(rr.Transform3D, "translation", components.Translation3DBatch(seen))
        self._stream.send_columns(FOLLOW, times, [followed])

    def _send_film(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> tuple[Single, Array]:
        """Write the film; return its nodes (frames, n, 3) and their mean (frames, 3)."""
        count, nodes = len(frames), len(self._share)
        positions, centre = np.empty((count, nodes, 3), dtype=np.float32), np.empty((count, 3))
        packed = np.empty((count, nodes), dtype=np.uint32)
        for begin in range(0, count, _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            x = frames.film.node_position(some)
            if self._stage.drawn is not None:
                x = x[:, self._film.nodes]
            positions[some], centre[some] = x, self._share @ x
            packed[some] = self._colours.packed(x, np.array([self._film.stress(one) for one in x]))
        each = np.full(count, nodes)
        columns = [
            column(rr.Mesh3D, "vertex_positions", components.Position3DBatch(positions.reshape(-1, 3)), each),
            column(rr.Mesh3D, "vertex_colors", components.ColorBatch(packed.ravel()), each),
        ]
        self._stream.send_columns("/world/soft/film", times, columns)
        return positions, centre

    def _send_cables(self, frames: TickBatch, positions: Single, times: Sequence[rr.TimeColumn]) -> None:
        tension = frames.cable_tension_N.reshape(-1, 1)
        taut = tension / (tension + _HALF_TAUT_N)
        shade = (1.0 - taut) * np.array(colours.GREY) + taut * np.array(colours.ORANGE)
        self._send_node_lines("cables", positions, self._film.cables, times, shade.astype(np.uint8))

    def _send_node_lines(
        self,
        name: str,
        positions: Single,
        lines: Sequence[IntArray],
        times: Sequence[rr.TimeColumn],
        shades: NDArray[np.uint8] | None = None,
    ) -> None:
        if not lines:
            return
        points = positions[:, np.concatenate(lines)].reshape(-1, 3)
        lengths = np.tile([len(line) for line in lines], len(positions))
        per_frame = np.full(len(positions), len(lines))
        send_lines(self._stream, f"/world/soft/{name}", times, points, lengths, per_frame, shades)
