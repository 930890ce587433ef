"""A picture of a sweep: columns of its table over another one; needs pandas and matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.errors import InputError
from cosim.results.plots import figure_kind
from cosim.sweeps.table import open_sweep


def plot_sweep(directory: str | Path, x: str, *ys: str, colour: str | None = None) -> Any:
    """Return a matplotlib figure of columns of a sweep; `figure.savefig(path)` writes it.

    Args:
        directory: of the sweep.
        x: column of the horizontal axis.
        ys: columns of the vertical axes, each in a separate plot.
        colour: column that colours the points; None for none.

    Raises:
        InputError: there is no such column of numbers, or pandas or matplotlib is not installed.
    """
    kind, frame = figure_kind(), open_sweep(directory)
    shown = frame[frame["status"] == "completed"]
    _check(shown, (x, *ys, *([colour] if colour else [])))
    if not ys:
        raise InputError("a plot needs a column for the horizontal axis and at least one vertical")
    figure = kind(figsize=(6.0 * len(ys), 4.2), layout="constrained")
    for axes, y in zip(figure.subplots(1, len(ys), squeeze=False)[0], ys, strict=True):
        points = axes.scatter(shown[x], shown[y], c=None if colour is None else shown[colour], s=14)
        axes.set_xlabel(_labelled(frame, x))
        axes.set_ylabel(_labelled(frame, y))
        axes.grid(alpha=0.3)
    if colour is not None:
        figure.colorbar(points, ax=figure.axes, label=_labelled(frame, colour))
    figure.suptitle(f"{len(shown)} of {len(frame)} designs completed", fontsize=10)
    return figure


def _check(frame: Any, names: Sequence[str]) -> None:
    numbers = list(frame.select_dtypes("number").columns)
    for name in names:
        if name not in numbers:
            raise InputError(f"there is no column of numbers '{name}'; there are {', '.join(numbers)}")


def _labelled(frame: Any, name: str) -> str:
    unit = frame.attrs["units"][name]
    return name if unit == "1" else f"{name} [{unit}]"
