"""One plot of a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from cosim.base.frames import Array
from cosim.recording.colours import Colour
from cosim.telemetry.tick_batch import TickBatch


@dataclass(frozen=True)
class Plot:
    """One plot with its curves.

    Args:
        entity: path under `/plots`; one below another plot's path joins that plot.
        title: with the unit; empty if the curves join another plot.
        tab: the tab it is shown in.
        series: name of each curve.
        colours: of each curve.
        values: the curves' values in a batch of k ticks, (k, series) or for one curve (k,), in the
            title's unit; not a number: no point.
        legend: whether the plot names its curves.
        peaks: whether crowded curves show their largest value rather than their range.
    """

    entity: str
    title: str
    tab: str
    series: tuple[str, ...]
    colours: Sequence[Colour]
    values: Callable[[TickBatch], Array]
    legend: bool = True
    peaks: bool = False
