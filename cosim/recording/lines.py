"""Writes lines to a recording, for many frames as one array, since converting single lines would take most of
the time. Also finds the creases of the drawn film, which show its shape where it has one colour.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.components import ColorBatch, LineStrip3DBatch

from cosim.base.frames import Array, IntArray
from cosim.recording.colours import Colour
from cosim.recording.columns import column
from cosim.soft.geometry.surface import dihedral_angle, interior_hinges

Points: TypeAlias = NDArray[np.floating[Any]]


def strip_array(points: Points, lengths: IntArray) -> Any:
    """Return an Arrow list array of lines from one array of their points, line after line.

    Args:
        points: (k, 3) [m].
        lengths: points of each line; they sum to k.
    """
    empty = LineStrip3DBatch([]).as_arrow_array()
    values = rr.encodings.Vec3DBatch(np.ascontiguousarray(points, dtype=np.float32)).as_arrow_array()
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return empty.from_arrays(offsets, values, type=empty.type)


def style_lines(stream: rr.RecordingStream, path: str, radius_m: float, colour: Colour | None = None) -> None:
    """Write the static style of the lines of an entity.

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
    # open lines first, from their ends; the remaining edges are closed lines
    starts = sorted(neighbours, key=lambda node: len(neighbours[node]) == 2)
    lines = (_walk(start, neighbours) for start in starts)
    return [np.array(line) for line in lines if len(line) > 1]


def _walk(start: int, neighbours: dict[int, list[int]]) -> list[int]:
    """Return the line of edges from a node to its end, and remove these edges."""
    line = [start]
    while neighbours[line[-1]]:
        here, there = line[-1], neighbours[line[-1]].pop()
        neighbours[there].remove(here)
        line.append(there)
    return line
