"""The report of a trade: a table in Markdown and a picture."""

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any, Final

from cosim.results.plots import figure_kind
from cosim.sweeps.trade_choice import FORCE_MEAN, pareto_front
from cosim.sweeps.trade_results import Measured

_ERRORS: Final = {
    "tip, largest [mm]": ("tip_error_m", 1e3),
    "tip, rms [mm]": ("tip_rms_m", 1e3),
    "tip, phase ends [mm]": ("end_error_m", 1e3),
    "objects, largest [mm]": ("object_error_m", 1e3),
    f"force, {FORCE_MEAN}, largest [N]": ("force_error_N", 1.0),
    "contact, rms [N]": ("contact_error_N", 1.0),
}
"""Columns of errors by their heads: the figure, and the factor from SI units."""


def markdown(title: str, results: Sequence[Measured]) -> str:
    """Return the table; candidates on the Pareto front have a star."""
    shown = {
        head: column
        for head, column in _ERRORS.items()
        if column[0] != "object_error_m" or any(math.isfinite(each.object_error_m) for each in results)
    }
    heads = ["", "candidate", "real-time factor: command", "loop", *shown, "iterations a tick"]
    front = pareto_front(results)
    lines = [
        f"# Speed against accuracy: {title}", "",
        "Errors are against the reference (marked ref), sampled every 20 ms of the run; of the flange force,",
        f"of its moving mean ({FORCE_MEAN}). The real-time factor is simulated time over CPU time, recording",
        "included, of the whole command without error bars, and of its loop alone. A star: no other",
        "candidate has both a faster command and a smaller error.", "",
        _line(heads),
        _line(["---", "---", *["---:"] * (len(shown) + 3)]),
    ]  # fmt: skip
    for result in results:
        mark = "ref" if result.reference else "*" if result in front else ""
        speeds = f"{result.real_time_factor:.2f}", f"{result.loop_factor:.2f}"
        cells = [*speeds, *(_cell(result, *column) for column in shown.values())]
        if result.failure:  # only its first clause fits
            reason = shorten(result.failure.split(";")[0].replace("|", "/"), 160, placeholder=" ...")
            cells = [reason, *[""] * (len(shown) + 1)]
        iterations = "" if result.failure else f"{result.iterations:.2f}"
        lines.append(_line([mark, result.candidate.name, *cells, iterations]))
    return "\n".join([*lines, *_reference_error(results)]) + "\n"


def _cell(result: Measured, name: str, factor: float) -> str:
    value = factor * float(getattr(result, name))
    return f"{value:.3g}" if math.isfinite(value) and not result.reference else ""


def _reference_error(results: Sequence[Measured]) -> list[str]:
    """Return lines with the reference's error, its distance from the next best one, unless that is 0."""
    for result in results:
        if result.candidate.reference and result.comparable and result.tip_error_m > 0.0:
            error = f'{1e3 * result.tip_error_m:.3g} mm, its distance from "{result.candidate.name}"'
            return ["", f"The reference itself has an error of about {error}."]
    return []


def _line(cells: Sequence[str]) -> str:
    return "|" + "|".join(cell if cell.startswith("---") else f" {cell.strip()} " for cell in cells) + "|"


def draw(title: str, results: Sequence[Measured], path: Path) -> None:
    """Draw the errors of the candidates over their speed into a PNG file.

    It shows positions with the Pareto front, the flange force's moving mean, and contact forces, if any.

    Raises:
        InputError: matplotlib is not installed.
    """
    figure_class = figure_kind()
    from matplotlib.ticker import LogLocator, NullLocator

    shown = [result for result in results if result.comparable]
    moving = any(math.isfinite(result.object_error_m) for result in shown)
    position = "largest error of tip and objects [mm]" if moving else "largest tip error [mm]"
    panels = {
        position: [1e3 * result.position_error_m for result in shown],
        f"largest error of the flange force, {FORCE_MEAN} [N]": [result.force_error_N for result in shown],
    }
    if any(result.contact_error_N > 0.0 for result in shown):
        panels["rms error of the sum of contact forces [N]"] = [result.contact_error_N for result in shown]
    figure = figure_class(figsize=(5.5 * len(panels), 4.8), layout="constrained")
    for axes, (label, errors) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
        _scatter(axes, shown, errors)
        axes.set(xscale="log", ylabel=label, xlabel="real-time factor of the command (CPU time)")
        axes.axvline(1.0, color="0.7", lw=0.8)
        axes.grid(alpha=0.3)
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
    front = pareto_front(shown)
    figure.axes[0].plot(
        [result.real_time_factor for result in front],
        [1e3 * result.position_error_m for result in front],
        "k--", lw=0.8, label="Pareto front",
    )  # fmt: skip
    figure.axes[0].legend(fontsize=7)
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=110)


def _scatter(axes: Any, results: Sequence[Measured], errors: Sequence[float]) -> None:
    """Draw a point for each candidate, labelled with its tick; other ticks of a model have its colour."""
    families: dict[str, list[tuple[float, float]]] = {}
    for result, error in zip(results, errors, strict=True):
        tick = f"{1e3 * float(result.candidate.changes['clock.tick_s']):g} ms"
        point = result.real_time_factor, error
        axes.annotate(tick, point, fontsize=6, xytext=(4, 3), textcoords="offset points")
        family = result.candidate.name.replace(f", {tick}", "")
        in_time = family != result.candidate.name
        families.setdefault(family if in_time else "other models", []).append(point)
    for (family, points), marker in zip(families.items(), "o^vDPx", strict=False):
        axes.plot(*zip(*points, strict=True), marker=marker, ls="", label=family)
    if errors and min(errors) > 0.0:
        axes.set_yscale("log")
