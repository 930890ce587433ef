"""Tables of a summary as text: phases, tip paths, the arm."""

import math
from typing import Any

from cosim.plan.arm_limits import UNITS


def phase_cells(phase: dict[str, Any]) -> tuple[str, ...]:
    """Return a phase's cells of the table: name, end, pressure, cables, tip, sag, tip error."""
    return (
        phase["name"] + ("" if phase["complete"] else " (incomplete)"),
        f"{phase['end_s']:.2f}",
        _scaled([entry["pressure_Pa"] for entry in phase["chambers"].values()], 1e-3),
        _scaled(phase["cable_tension_N"], 1.0),
        _scaled(phase["tip_position_m"], 1e3),
        _scaled(phase["sag_m"], 1e3),
        _scaled(phase["tip_error_m"], 1e3, 3) if "tip_error_m" in phase else "",
    )


def _scaled(value: Any, scale: float, digits: int = 1) -> str:
    if isinstance(value, list):
        return ", ".join(_scaled(item, scale, digits) for item in value)
    return "?" if value is None else f"{scale * value:.{digits}f}"


def path_lines(phases: list[dict[str, Any]]) -> list[str]:
    """Return the Markdown table of phases that follow a path; empty without any."""
    rows = [(phase["name"], phase["tip_path"]) for phase in phases if "tip_path" in phase]
    if not rows:
        return []
    head = "| tip path | length [mm] | speed [mm/s] | of | largest error [mm] | mean [mm] | angle [deg] |"
    lines = ["", head, "|---|---|---|---|---|---|---|"]
    for name, path in rows:
        about = name, f"{1e3 * path['length_m']:.1f}", f"{1e3 * path['speed_m_s']:g}"
        for of, errors in (
            ("run", path),
            ("planned", path["planned"]),
            ("uncompensated", path["uncompensated"]),
        ):
            lines.append("| " + " | ".join((*about, of, *_error_cells(errors))) + " |")
    return lines


def _error_cells(errors: dict[str, Any] | None) -> tuple[str, ...]:
    if errors is None:
        return ("no equilibria", "", "")
    scaled = (
        (errors["largest_error_m"], 1e3),
        (errors["mean_error_m"], 1e3),
        (errors["largest_angle_rad"], 180.0 / math.pi),
    )
    return tuple("?" if value is None else f"{scale * value:.3f}" for value, scale in scaled)


def arm_table(arm: dict[str, Any] | None) -> list[str]:
    """Return the Markdown table of a summary's section on the arm; empty without an arm."""
    if arm is None:
        return []
    lines = ["", "| arm | of | joint | value | bound | at [s] | phase |", "|---|---|---|---|---|---|---|"]
    for of, extremes in arm.items():
        for name in UNITS:
            extreme = extremes.get(name)
            if extreme is None:
                continue
            value, bound = ("none" if x is None else f"{x:.4g}" for x in (extreme["value"], extreme["bound"]))
            cells = (
                f"{name.replace('_', ' ')} [{extreme['unit']}]", of, extreme["joint"], value, bound,
                f"{extreme['time_s']:.2f}", extreme["phase"],
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return [*lines, ""]
