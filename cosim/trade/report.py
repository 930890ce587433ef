"""What trades are reported as, and which candidate meets a requirement.

Which candidates of a trade are worth having; the trade as Markdown, JSON and a picture.

Which candidates are worth having, and which one to take.

A trade as a picture: errors of positions and forces against the real-time factor, Pareto front marked.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any, final

from cosim._version import __version__
from cosim.errors import InputError
from cosim.results.result import figure_kind
from cosim.trade.measuring import FORCE_MEAN, Measured

RESERVE = 0.15
"""Share of a budget by which a candidate is to be faster, as the speed of a machine varies."""

_LENGTHS_m = {"mm": 1e-3, "um": 1e-6, "cm": 1e-2, "m": 1.0}


@final
@dataclass(frozen=True)
class Requirement:
    """What a candidate shall meet; None: anything will do.

    Args:
        budget: least real-time factor.
        tolerance_m: largest error of the tip, and of objects that can move.
        force_N: largest error of the flange force's moving mean.
    """

    budget: float | None = None
    tolerance_m: float | None = None
    force_N: float | None = None

    def met_by(self, result: Measured, reserve: float = 0.0) -> bool:
        """Whether a candidate meets all of it, the budget with a reserve: speeds vary from run to run."""
        return (
            (self.budget is None or result.real_time_factor >= (1.0 + reserve) * self.budget)
            and (self.tolerance_m is None or result.position_error_m <= self.tolerance_m)
            and (self.force_N is None or result.force_error_N <= self.force_N)
        )

    @property
    def words(self) -> str:
        """The requirement in words."""
        parts = []
        if self.budget is not None:
            parts.append(f"budget real-time factor {self.budget:g}")
        if self.tolerance_m is not None:
            parts.append(f"tolerance tip error {1e3 * self.tolerance_m:g} mm")
        if self.force_N is not None:
            parts.append(f"tolerance flange force ({FORCE_MEAN}) {self.force_N:g} N")
        return ", ".join(parts) or "no requirement"


def pareto_front(results: Sequence[Measured]) -> list[Measured]:
    """Return those that no other one beats in both position error and real-time factor, fastest first."""
    ordered = sorted(
        (result for result in results if result.comparable),
        key=lambda result: (-result.real_time_factor, result.position_error_m),
    )
    front: list[Measured] = []
    for result in ordered:
        if not front or result.position_error_m < front[-1].position_error_m:
            front.append(result)
    return front


def eligible(results: Sequence[Measured]) -> list[Measured]:
    """Return the candidates of the table that a choice is made from: the first one."""
    group = results[0].candidate.group if results else "time"
    return [result for result in results if result.candidate.group == group]


def pick(results: Sequence[Measured], requirement: Requirement) -> Measured | None:
    """Return the candidate that meets a requirement best, or None if none meets it.

    Where none meets a budget with the reserve, the fastest of those that meet it without is taken.

    Args:
        results: of one group.
        requirement: with a budget, the least position error is best; without, the greatest speed.
    """
    comparable = [result for result in results if result.comparable]
    safe = [result for result in comparable if requirement.met_by(result, RESERVE)]
    if requirement.budget is not None and safe:
        return min(safe, key=lambda result: (result.position_error_m, -result.real_time_factor))
    able = [result for result in comparable if requirement.met_by(result)]
    return max(able, key=lambda result: (result.real_time_factor, -result.position_error_m), default=None)


def parse_budget(text: str) -> float:
    """Return the real-time factor of a text such as "1.0x".

    Raises:
        InputError: it is none.
    """
    return _positive(text.strip().removesuffix("x"), text, "a real-time factor, such as 1.0x")


def parse_tolerance(text: str) -> float:
    """Return the length [m] of a text such as "1mm"; metres if there is no unit.

    Raises:
        InputError: it is none.
    """
    number = text.strip()
    for unit, metres in _LENGTHS_m.items():
        if number.endswith(unit):
            return metres * _positive(number.removesuffix(unit), text, "a length, such as 1mm")
    return _positive(number, text, "a length, such as 1mm")


def parse_force(text: str) -> float:
    """Return the force [N] of a text such as "0.1N".

    Raises:
        InputError: it is none.
    """
    return _positive(text.strip().removesuffix("N"), text, "a force, such as 0.1N")


def _positive(number: str, text: str, wanted: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise InputError(f"'{text}' is not {wanted}")
    return value


GROUPS = {"time": "Fidelity, and how time is stepped", "model": "What is modelled (all at one tick)"}


@final
@dataclass(frozen=True)
class _Column:
    """A column of errors: its head, the figure, and the factor from SI units."""

    head: str
    name: str
    factor: float = 1.0
    optional: bool = False

    def cell(self, result: Measured) -> str:
        """Return the figure in its unit; empty for none."""
        value = self.factor * float(getattr(result, self.name))
        return f"{value:.3g}" if math.isfinite(value) and not result.reference else ""


_COLUMNS = (
    _Column("tip, largest [mm]", "tip_error_m", 1e3),
    _Column("tip, rms [mm]", "tip_rms_m", 1e3),
    _Column("tip, phase ends [mm]", "end_error_m", 1e3),
    _Column("objects, largest [mm]", "object_error_m", 1e3, optional=True),
    _Column(f"force, {FORCE_MEAN}, largest [N]", "force_error_N"),
    _Column("contact, rms [N]", "contact_error_N"),
    _Column("tip, from the model as it is, largest [mm]", "base_error_m", 1e3, optional=True),
)


def markdown(title: str, results: Sequence[Measured]) -> str:
    """Return the tables of all groups; candidates on the Pareto front have a star."""
    lines = [f"# Speed against accuracy: {title}", ""]
    lines += [
        "Errors are against the reference of each table (marked ref), sampled every 20 ms of the run; of the",
        f"flange force, of its moving mean ({FORCE_MEAN}). The real-time factor is simulated time over CPU",
        "time of the loop, recording included. A star: no other candidate of the table is both faster and",
        "nearer to the reference.",
    ]
    for group, heading in GROUPS.items():
        candidates = [result for result in results if result.candidate.group == group]
        if candidates:
            lines += ["", f"## {heading}", "", *_table(candidates), *_own_error(candidates)]
    return "\n".join(lines) + "\n"


def _table(results: Sequence[Measured]) -> list[str]:
    shown = [
        column
        for column in _COLUMNS
        if not column.optional or any(math.isfinite(getattr(result, column.name)) for result in results)
    ]
    heads = ["", "candidate", "real-time factor", *(column.head for column in shown), "iterations a tick"]
    rule = ["---", "---", *(["---:"] * (len(shown) + 2))]
    front = pareto_front(results)
    rows = [_line(heads), _line(rule)]
    for result in results:
        mark = "ref" if result.reference else "*" if result in front else ""
        if result.failure:
            rows.append(
                _line([mark, result.candidate.name, _short(result.failure), *[""] * (len(shown) + 1)])
            )
            continue
        cells = [f"{result.real_time_factor:.2f}", *(column.cell(result) for column in shown)]
        rows.append(_line([mark, result.candidate.name, *cells, f"{result.iterations:.2f}"]))
    return rows


def _own_error(results: Sequence[Measured]) -> list[str]:
    """Return how far a reference is from converged, as far as the next best one, unless that is the same."""
    for result in results:
        if result.candidate.reference and result.comparable and result.tip_error_m > 0.0:
            return [
                "",
                f"The reference itself has an error of about {1e3 * result.tip_error_m:.3g} mm, its "
                f'distance from "{result.candidate.name}".',
            ]
    return []


def _line(cells: Sequence[str]) -> str:
    return "|" + "|".join(cell if cell.startswith("---") else f" {cell.strip()} " for cell in cells) + "|"


def _short(failure: str) -> str:
    """Return the first clause of a message; a table has no room for more."""
    return shorten(failure.split(";")[0].replace("|", "/"), 160, placeholder=" ...")


def figures_text(result: Measured) -> str:
    """Return speed and errors in words."""
    objects = (
        f"objects {1e3 * result.object_error_m:.3g} mm, " if math.isfinite(result.object_error_m) else ""
    )
    return (
        f"x{result.real_time_factor:.2f} real time, tip {1e3 * result.tip_error_m:.3g} mm, {objects}"
        f"force ({FORCE_MEAN}) {result.force_error_N:.3g} N off"
    )


def result_line(result: Measured) -> str:
    """Return what became of a candidate, in one line."""
    if result.failure:
        return f"{result.candidate.name}: {result.failure}"
    if result.reference:
        return f"{result.candidate.name}: x{result.real_time_factor:.2f} real time, the reference"
    return f"{result.candidate.name}: {figures_text(result)}"


def choice_lines(results: Sequence[Measured], requirement: Requirement) -> str:
    """Return which candidate meets a requirement, and how to run it."""
    found = pick(eligible(results), requirement)
    if found is None:
        return f"No candidate meets {requirement.words}."
    return (
        f"For {requirement.words}: {found.candidate.name} (x{found.real_time_factor:.2f} real time, "
        f"{1e3 * found.position_error_m:.3g} mm, force, {FORCE_MEAN}, {found.force_error_N:.3g} N). "
        f"Run it with: {found.candidate.words}"
    )


def as_json(title: str, results: Sequence[Measured], requirement: Requirement | None) -> str:
    """Return everything as a JSON document; numbers that are not finite become null."""
    chosen = pick(eligible(results), requirement) if requirement else None
    fronts = [r for group in GROUPS for r in pareto_front([m for m in results if m.candidate.group == group])]
    document = {
        "cosim": __version__,
        "scenario": title,
        "choice": chosen.candidate.name if chosen else None,
        "candidates": [{**entry(result), "pareto": result in fronts} for result in results],
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def entry(result: Measured) -> dict[str, Any]:
    """Return a candidate and its figures in JSON's own kinds."""
    numbers = {
        name: value if math.isfinite(value) else None
        for name, value in vars(result).items()
        if isinstance(value, float)
    }
    candidate = result.candidate
    return {
        "name": candidate.name,
        "group": candidate.group,
        "reference": result.reference,
        "changes": dict(candidate.changes),
        **numbers,
        "failure": result.failure or None,
    }


_STYLES = {
    "Euler, 1 tangent": ("o", "tab:blue"),
    "Euler, converged": ("s", "tab:cyan"),
    "BDF2, 1 tangent": ("^", "tab:red"),
    "BDF2, converged": ("v", "tab:orange"),
    "rigid": ("D", "tab:gray"),
    "section": ("P", "tab:green"),
}


def draw(title: str, results: Sequence[Measured], path: Path) -> None:
    """Draw errors of the candidates that a choice is made from into a PNG file.

    Positions, the flange force's moving mean, and contact forces where there are any, over the speed.

    Args:
        title: of the scenario.
        results: all candidates.
        path: of the file.

    Raises:
        InputError: matplotlib is not installed.
    """
    kind = figure_kind()
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    shown = [result for result in eligible(results) if result.comparable]
    front = pareto_front(shown)
    moving = any(math.isfinite(result.object_error_m) for result in shown)
    touching = any(result.contact_error_N > 0.0 for result in shown)
    figure = kind(figsize=(15.0 if touching else 11.0, 4.8))
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
