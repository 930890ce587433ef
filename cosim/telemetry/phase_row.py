"""The row of a summary's table on a phase."""

from __future__ import annotations

from typing import Any


def phase_row(phase: dict[str, Any]) -> str:
    """Return the Markdown line on a phase."""
    cells = (
        phase["name"] + ("" if phase["complete"] else " (incomplete)"),
        f"{phase['end_s']:.2f}",
        _scaled([entry["pressure_Pa"] for entry in phase["chambers"].values()], 1e-3),
        _scaled(phase["cable_tension_N"], 1.0),
        _scaled(phase["tip_position_m"], 1e3),
        _scaled(phase["sag_m"], 1e3),
        _scaled(phase["tip_error_m"], 1e3, 3) if "tip_error_m" in phase else "",
    )
    return "| " + " | ".join(cells) + " |"


def _scaled(value: Any, scale: float, digits: int = 1) -> str:
    if isinstance(value, list):
        return ", ".join(_scaled(item, scale, digits) for item in value)
    return "?" if value is None else f"{scale * value:.{digits}f}"
