"""A run as a short table for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any


def as_html(text: str, summary: Mapping[str, Any]) -> str:
    """Return a run's outcome and its phases as HTML.

    Args:
        text: lines on the run.
        summary: of the run.
    """
    lines = [*text.split("\n"), *([f"reason: {summary['reason']}"] if summary.get("reason") else [])]
    lines += [f"warning: {text}" for text in summary.get("warnings", ())]
    heads = ("phase", "end [s]", "pressure [kPa]", "tip [mm]", "sag [mm]")
    rows = [
        (
            phase["name"] + ("" if phase["complete"] else " (incomplete)"),
            f"{phase['end_s']:.2f}",
            ", ".join(_scaled(entry["pressure_Pa"], 1e-3) for entry in phase["chambers"].values()),
            ", ".join(_scaled(value, 1e3) for value in phase["tip_position_m"]),
            _scaled(phase["sag_m"], 1e3),
        )
        for phase in summary["phases"]
    ]
    table = "".join(_row("td", row) for row in rows)
    texts = "<br>".join(map(escape, lines))
    return f"<div>{texts}<table><thead>{_row('th', heads)}</thead><tbody>{table}</tbody></table></div>"


def _row(kind: str, cells: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<{kind}>{escape(cell)}</{kind}>" for cell in cells) + "</tr>"


def _scaled(value: float | None, scale: float) -> str:
    return "?" if value is None else f"{scale * value:.1f}"
