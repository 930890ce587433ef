"""A summary as a text for people."""

from __future__ import annotations

from typing import Any

from cosim.telemetry.arm_figures import arm_table
from cosim.telemetry.phase_row import phase_row
from cosim.telemetry.tip_path_figures import path_lines


def summary_markdown(summary: dict[str, Any]) -> str:
    """Return the summary as a Markdown text for people."""
    factor = summary["real_time_factor"]
    lines = [
        f"## {summary['title']}",
        "",
        f"Status: **{summary['status']}**" + (f" ({summary['reason']})" if summary["reason"] else ""),
        "",
        f"- {summary['simulated_s']:.3f} s simulated in {summary['wall_s']:.2f} s"
        + (f", real-time factor {factor:.2f}" if factor is not None else ""),
        f"- {summary['ticks']} of {summary['planned_ticks']} ticks of {1e3 * summary['tick_s']:g} ms, "
        f"{summary['newton_iterations']} Newton iterations"
        + (f", {summary['slides']} slides to another branch of equilibria" if summary["slides"] else ""),
        f"- largest residual {_figure(summary['max_equilibrium_residual_N'])} N, "
        f"largest power error {_figure(summary['max_interface_power_error_W'])} W",
        "",
        *(f"- warning: {line}" for line in summary["warnings"]),
        *arm_table(summary["arm"]),
        "| phase | end [s] | pressure [kPa] | cables [N] | tip [mm] | sag [mm] | tip error [mm] |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = [phase_row(phase) for phase in summary["phases"]]
    return "\n".join(lines + rows + path_lines(summary["phases"])) + "\n"


def _figure(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.2e}"
