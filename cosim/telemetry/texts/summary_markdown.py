"""A summary as Markdown."""

from typing import Any

from cosim.telemetry.figures.overlap_figures import overlap_lines
from cosim.telemetry.figures.touched import touched_lines
from cosim.telemetry.texts.closing_lines import error_line, target_lines
from cosim.telemetry.texts.mode_lines import swing_lines
from cosim.telemetry.texts.object_lines import object_lines
from cosim.telemetry.texts.stability_lines import branching_lines, stability_lines
from cosim.telemetry.texts.summary_tables import arm_table, path_lines, phase_cells


def summary_markdown(summary: dict[str, Any]) -> str:
    """Return the summary as Markdown."""
    lines = [
        f"## {summary['title']}",
        "",
        f"Status: **{summary['status']}**" + (f" ({summary['reason']})" if summary["reason"] else ""),
        "",
        f"- {summary['simulated_s']:.3f} s simulated in {summary['command_s']:.2f} s: start "
        f"{summary['startup_s']:.2f} s, ticks {summary['wall_s']:.2f} s, error bars "
        f"{summary['error']['wall_s']:.2f} s",
        f"- {summary['ticks']} of {summary['planned_ticks']} ticks of {1e3 * summary['tick_s']:g} ms, "
        f"{summary['newton_iterations']} Newton iterations"
        + (f", {summary['slides']} slides to another branch of equilibria" if summary["slides"] else ""),
        f"- largest residual {_figure(summary['max_equilibrium_residual_N'])} N, "
        f"largest power error {_figure(summary['max_interface_power_error_W'])} W",
        "",
        *(f"- warning: {line}" for line in summary["warnings"]),
        *(f"- stability: {line}" for line in branching_lines(summary["branchings"])),
        *(f"- stability: {line}" for line in stability_lines(summary["phases"])),
        *(f"- natural frequencies: {line}" for line in swing_lines(summary["phases"])),
        *(f"- overlap: {line}" for line in overlap_lines(summary["overlaps"])),
        *(f"- contact: {line}" for line in touched_lines(summary["touched"])),
        *(f"- target: {line}" for line in target_lines(summary["phases"])),
        *(f"- object: {line}" for line in object_lines(summary["objects"])),
        f"- error: {error_line(summary)}",
        *arm_table(summary["arm"]),
        "| phase | end [s] | pressure [kPa] | cables [N] | tip [mm] | sag [mm] | tip error [mm] |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = [f"| {' | '.join(phase_cells(phase))} |" for phase in summary["phases"]]
    return "\n".join(lines + rows + path_lines(summary["phases"])) + "\n"


def _figure(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.2e}"
