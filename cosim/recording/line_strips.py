"""Lines of many frames as one array: converting them one by one would cost more than all the rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from cosim.frames import IntArray
from cosim.recording.colours import Colour

Points: TypeAlias = NDArray[np.floating[Any]]


def strip_array(points: Points, lengths: IntArray) -> Any:
    """Return an Arrow list array of lines that lie one after the other in one array of points.

    Args:
        points: (k, 3) [m].
        lengths: points of each line; they sum to k.
    """
    empty = rr.components.LineStrip3DBatch([]).as_arrow_array()
    values = rr.encodings.Vec3DBatch(np.ascontiguousarray(points, dtype=np.float32)).as_arrow_array()
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    return empty.from_arrays(offsets, values, type=empty.type)


def send_lines(
    stream: rr.RecordingStream,
    path: str,
    times: Sequence[rr.TimeColumn],
    points: Points,
    lengths: IntArray,
    lines_per_frame: IntArray,
    *,
    colours: Sequence[Colour],
    radius_m: float,
) -> None:
    """Write lines, any number per frame.

    Args:
        stream: to write to.
        path: of the entity.
        times: time columns, one row per frame.
        points: (k, 3) [m], of all lines of all frames.
        lengths: points of each line.
        lines_per_frame: (frames,).
        colours: one per line.
        radius_m: of all lines [m].
    """
    frames = len(lines_per_frame)
    packed = np.asarray(colours, dtype=np.uint32).reshape(-1, 3)
    rgba = (packed[:, 0] << 24) | (packed[:, 1] << 16) | (packed[:, 2] << 8) | np.uint32(0xFF)
    columns = [
        *rr.LineStrips3D.columns(strips=strip_array(points, lengths), colors=rgba).partition(lines_per_frame),
        *rr.LineStrips3D.columns(radii=[radius_m] * frames),
    ]
    stream.send_columns(path, times, columns)
