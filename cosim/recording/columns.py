"""Rows gathered over many ticks, written as columns of components straight from arrays.

Columns of components, straight from arrays: an archetype's `columns` looks at every field that it has.

Lines of many frames as one array: converting them one by one would cost more than all the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias, final

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.components import ColorBatch, LineStrip3DBatch

from cosim.base.frames import Array, IntArray
from cosim.recording.blueprint import TICKS, TIMELINE
from cosim.recording.colours import WHITE, Colour
from cosim.recording.plots import Plot
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
