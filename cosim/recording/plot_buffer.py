"""Buffers the values of all plots, one row per tick, and writes them as columns."""

from collections.abc import Sequence
from typing import final

import numpy as np
import rerun as rr

from cosim.base.frames import Array, IntArray
from cosim.recording.colours import WHITE
from cosim.recording.columns import column, time_columns
from cosim.recording.plots import Plot
from cosim.telemetry.tick_batch import TickBatch


@final
class PlotBuffer:
    """A buffer of the values of all plots, one row per tick.

    Args:
        stream: to write to.
        plots: plots of the recording.
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
        """Add the values of some ticks."""
        columns = [plot.values(batch).reshape(len(batch), len(plot.series)) for plot in self._plots]
        self._values.append(np.concatenate(columns, axis=1))
        self._ticks.append(batch.tick)

    def flush(self) -> None:
        """Write the buffer and empty it."""
        if not self._values:
            return
        values, ticks = np.concatenate(self._values), np.concatenate(self._ticks)
        times = time_columns(ticks, self._tick_ns)
        start = 0
        for plot in self._plots:
            stop = start + len(plot.series)
            curves = values[:, start:stop]
            numbers = ~np.isnan(curves).any(axis=1)
            if numbers.all():
                self._send(plot, times, curves)
            elif numbers.any():
                self._send(plot, time_columns(ticks[numbers], self._tick_ns), curves[numbers])
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
