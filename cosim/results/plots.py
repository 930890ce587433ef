"""Pictures of curves over time, by matplotlib."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

from cosim.base.frames import Array
from cosim.errors import InputError

_COLUMNS: Final = 2


@final
@dataclass(frozen=True)
class Panel:
    """A plot of the curves of an array.

    Args:
        title: of the array.
        unit: of the values.
        values: (rows, curves).
        labels: of the curves; empty for a single curve.
    """

    title: str
    unit: str
    values: Array
    labels: Sequence[str]


def figure_of(panels: Sequence[Panel], time_s: Array, changes_s: Sequence[float], title: str) -> Any:
    """Return a matplotlib figure of panels.

    Args:
        panels: at least one.
        time_s: (rows,).
        changes_s: times of vertical lines.
        title: of the figure.

    Raises:
        InputError: matplotlib is not installed.
    """
    rows = -(-len(panels) // _COLUMNS)
    figure = figure_kind()(figsize=(11.0, 2.4 * rows + 0.6), layout="constrained")
    plots = figure.subplots(rows, min(len(panels), _COLUMNS), sharex=True, squeeze=False).ravel()
    for plot, panel in zip(plots, panels, strict=False):
        plot.plot(time_s, panel.values, lw=1.0, label=panel.labels or None)
        plot.set_ylabel(panel.title if panel.unit == "1" else f"{panel.title} [{panel.unit}]")
        plot.grid(alpha=0.3)
        if panel.labels:
            plot.legend(fontsize=7)
        for change_s in changes_s:
            plot.axvline(change_s, color="0.7", lw=0.8)
    for plot in plots[len(panels) :]:
        plot.remove()
    for plot in plots[max(len(panels) - _COLUMNS, 0) : len(panels)]:
        plot.set_xlabel("time [s]")
        plot.tick_params(labelbottom=True)
    figure.suptitle(title, fontsize=10)
    return figure


def figure_kind() -> Any:
    """Return matplotlib's class of figures; they need no screen.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("plots need matplotlib: pip install 'cosim[plot]'") from None
    return Figure
