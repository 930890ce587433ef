"""Rows gathered over many ticks, written as columns: one call costs as much for 500 rows as for one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import rerun as rr

from cosim.frames import Array, IntArray
from cosim.recording.blueprint import TICKS, TIMELINE
from cosim.recording.plot import Plot
from cosim.scenario.snapshot import Snapshot


def time_columns(ticks: Sequence[int] | IntArray, tick_ns: int) -> list[rr.TimeColumn]:
    """Return both timelines of some ticks; whole nanoseconds, because rounded seconds would not join.

    Args:
        ticks: rising.
        tick_ns: length of a tick [ns].
    """
    count = np.asarray(ticks, dtype=np.int64)
    duration = (count * tick_ns).astype("timedelta64[ns]")
    return [rr.TimeColumn(TIMELINE, duration=duration), rr.TimeColumn(TICKS, sequence=count)]


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
        self._ticks: list[int] = []
        self._rows: list[list[float]] = []
        self._styled: set[str] = set()

    def append(self, snapshot: Snapshot) -> None:
        """Take the values of one tick."""
        row: list[float] = []
        for plot in self._plots:
            row.extend(plot.values(snapshot))
        self._rows.append(row)
        self._ticks.append(snapshot.tick)

    def flush(self) -> None:
        """Write what was gathered."""
        if not self._rows:
            return
        values = np.array(self._rows, dtype=np.float64)
        ticks = np.array(self._ticks, dtype=np.int64)
        start = 0
        for plot in self._plots:
            stop = start + len(plot.series)
            self._send(plot, ticks, values[:, start:stop])
            start = stop
        self._rows.clear()
        self._ticks.clear()

    def _send(self, plot: Plot, ticks: IntArray, values: Array) -> None:
        kept = ~np.isnan(values).any(axis=1)
        if not kept.any():
            return
        path = f"/plots/{plot.entity}"
        if path not in self._styled:  # a curve that never gets a point must not appear in the legend
            self._styled.add(path)
            widths = [2.0] * len(plot.series)
            policy = rr.components.AggregationPolicy.Max if plot.peaks else None
            style = rr.SeriesLines(
                colors=plot.colours, names=plot.series, widths=widths, aggregation_policy=policy
            )
            self._stream.log(path, style, static=True)
        columns = rr.Scalars.columns(scalars=values[kept])
        self._stream.send_columns(path, time_columns(ticks[kept], self._tick_ns), columns)
