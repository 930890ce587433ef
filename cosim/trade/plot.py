"""A trade as a picture: errors of positions and forces against the real-time factor, Pareto front marked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.trade.choice import eligible, pareto_front
from cosim.trade.measured import FORCE_MEAN, Measured

_STYLES = {
    "Euler, 1 tangent": ("o", "tab:blue"),
    "Euler, converged": ("s", "tab:cyan"),
    "BDF2, 1 tangent": ("^", "tab:red"),
    "BDF2, converged": ("v", "tab:orange"),
    "rigid": ("D", "tab:gray"),
    "section": ("P", "tab:green"),
}


def can_draw() -> bool:
    """Whether matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True


def draw(title: str, results: Sequence[Measured], path: Path) -> None:
    """Draw errors of the candidates that a choice is made from into a PNG file; needs matplotlib.

    Positions, the flange force's moving mean, and contact forces where there are any, over the speed.

    Args:
        title: of the scenario.
        results: all candidates.
        path: of the file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    shown = [result for result in eligible(results) if result.comparable]
    front = pareto_front(shown)
    moving = any(math.isfinite(result.object_error_m) for result in shown)
    touching = any(result.contact_error_N > 0.0 for result in shown)
    figure = Figure(figsize=(15.0 if touching else 11.0, 4.8))
    FigureCanvasAgg(figure)
    left, *others = figure.subplots(1, 3 if touching else 2)
    _scatter(left, shown, [1e3 * result.position_error_m for result in shown])
    left.plot([r.real_time_factor for r in front], [1e3 * r.position_error_m for r in front], "k--", lw=0.8,
              label="Pareto front")  # fmt: skip
    left.set_ylabel("largest error of tip and objects [mm]" if moving else "largest tip error [mm]")
    _scatter(others[0], shown, [result.force_error_N for result in shown])
    others[0].set_ylabel(f"largest error of the flange force, {FORCE_MEAN} [N]")
    if touching:
        _scatter(others[1], shown, [result.contact_error_N for result in shown])
        others[1].set_ylabel("rms error of the sum of contact forces [N]")
    for axes in (left, *others):
        axes.set_xscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
                axis.set_minor_locator(NullLocator())
        axes.set_xlabel("real-time factor (CPU time of one core, recording on)")
        axes.axvline(1.0, color="0.7", lw=0.8)
        axes.grid(alpha=0.3)
    left.legend(fontsize=7)
    figure.suptitle(title, fontsize=10)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def _scatter(axes: Any, results: Sequence[Measured], errors: Sequence[float]) -> None:
    labelled = set()
    for result, error in zip(results, errors, strict=True):
        label = result.candidate.family or "other models"
        marker, colour = _STYLES.get(label, ("x", "black"))
        tick = f"{1e3 * float(result.candidate.changes.get('clock.tick_s', 0.0)):g} ms"
        axes.plot(result.real_time_factor, error, marker=marker, color=colour, ls="",
                  label=None if label in labelled else label)  # fmt: skip
        axes.annotate(tick, (result.real_time_factor, error), fontsize=6, xytext=(4, 3),
                      textcoords="offset points")  # fmt: skip
        labelled.add(label)
    if errors and min(errors) > 0.0:
        axes.set_yscale("log")
