"""A trade as Markdown and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any, final

from cosim._version import __version__
from cosim.trade.choice import Requirement, eligible, pareto_front, pick
from cosim.trade.measured import FORCE_MEAN, Measured

GROUPS = {
    "time": "Fidelity, and how time is stepped",
    "model": "What is modelled (all at one tick)",
}


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
                f"The reference has an error of its own, of about {1e3 * result.tip_error_m:.3g} mm: so far "
                f'from it is "{result.candidate.name}".',
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
