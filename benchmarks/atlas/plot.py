"""Draws the stability atlas: one panel a map, one square a point."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch

COLOURS = {
    "stable": "#2a9d5c",
    "slow": "#e9c46a",
    "no descent": "#7a8fb8",
    "iteration limit": "#9fb0d0",
    "tangent indefinite": "#56698f",
    "not finite": "#b39bc8",
    "refused as input": "#c9c9c9",
    "other named failure": "#6c4f7d",
    "no name": "#d00000",
}
COLUMNS = 6


def category(point: dict[str, Any]) -> str:
    """Return which colour a point gets."""
    if point["kind"] != "named":
        return "no name" if point["kind"] == "unnamed" else str(point["kind"])
    words = {"NO_DESCENT": "no descent", "ITERATION_LIMIT": "iteration limit",
             "INDEFINITE": "tangent indefinite", "NOT_FINITE": "not finite"}  # fmt: skip
    for outcome, words_for_people in words.items():
        if outcome in point["name"]:
            return words_for_people
    refused = point["name"] in ("MeshError", "ScenarioError", "InputError", "UnreachableError")
    return "refused as input" if refused else "other named failure"


def _label(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _panel(axes: Axes, result: dict[str, Any]) -> None:
    points: Sequence[dict[str, Any]] = result["points"]
    x, y = (list(dict.fromkeys(point[result[axis]] for point in points)) for axis in ("x", "y"))
    order = list(COLOURS)
    image = [[0] * len(x) for _ in y]
    for point in points:
        image[y.index(point[result["y"]])][x.index(point[result["x"]])] = order.index(category(point))
    colours = mpl.colors.ListedColormap(list(COLOURS.values()))
    axes.imshow(image, cmap=colours, vmin=-0.5, vmax=len(order) - 0.5, origin="lower", aspect="auto")
    axes.set_xticks(range(len(x)), [_label(value) for value in x], rotation=90, fontsize=6)
    axes.set_yticks(range(len(y)), [_label(value) for value in y], fontsize=6)
    axes.set_xlabel(result["x"], fontsize=7)
    axes.set_ylabel(result["y"], fontsize=7)
    axes.set_title(result["title"], fontsize=8)


def draw(results: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw all maps into a PNG file."""
    rows = -(-len(results) // COLUMNS)
    figure, grid = plt.subplots(rows, COLUMNS, figsize=(3.1 * COLUMNS, 2.9 * rows), squeeze=False)
    for axes in grid.ravel()[len(results) :]:
        axes.set_axis_off()
    for axes, result in zip(grid.ravel(), results, strict=False):
        _panel(axes, result)
    figure.legend(handles=[Patch(color=colour, label=name) for name, colour in COLOURS.items()],
                  loc="lower center", ncol=len(COLOURS), fontsize=8)  # fmt: skip
    figure.tight_layout(rect=(0.0, 0.025, 1.0, 1.0))
    figure.savefig(path, dpi=80)
    plt.close(figure)
