"""A run as a short table in HTML, for notebooks."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

from cosim.telemetry.figures.overlap_figures import overlap_lines
from cosim.telemetry.texts.stability_lines import branching_lines
from cosim.telemetry.texts.summary_tables import phase_cells

_SHOWN_CELLS: Final = (0, 1, 2, 4, 5)
"""Cells of a phase's row in the summary."""


def as_html(text: str, summary: Mapping[str, Any]) -> str:
    """Return a run's outcome and phases as HTML.

    Args:
        text: lines on the run.
        summary: of the run.
    """
    lines = [*text.split("\n"), *([f"reason: {summary['reason']}"] if summary.get("reason") else [])]
    lines += [f"warning: {text}" for text in summary.get("warnings", ())]
    heads = ("phase", "end [s]", "pressure [kPa]", "tip [mm]", "sag [mm]")
    lines += [f"stability: {text}" for text in branching_lines(summary.get("branchings", []))]
    lines += [f"overlap: {text}" for text in overlap_lines(summary.get("overlaps", []))]
    rows = [[phase_cells(phase)[k] for k in _SHOWN_CELLS] for phase in summary["phases"]]
    table = "".join(_row("td", row) for row in rows)
    texts = "<br>".join(map(escape, lines))
    return f"<div>{texts}<table><thead>{_row('th', heads)}</thead><tbody>{table}</tbody></table></div>"


def _row(kind: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{kind}>{escape(cell)}</{kind}>" for cell in cells) + "</tr>"
