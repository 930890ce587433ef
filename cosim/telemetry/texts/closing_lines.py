"""The lines that end a run on screen, from its summary."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from cosim.plan.arm_limits import PLANNED
from cosim.telemetry.figures.overlap_figures import overlap_lines
from cosim.telemetry.texts.bar_lines import BARS
from cosim.telemetry.texts.object_lines import object_lines
from cosim.telemetry.texts.stability_lines import branching_lines, stability_lines, undecided_warnings

_ITSELF: Final = "contact with itself"
_NAMED: Final = 3
"""Phases in a line by their names; the others are counted."""
_WIDTH: Final = len("stability: ")
_LEAST_COMPILING_S: Final = 1.0
"""Time of compiling kernels [s] below which the line leaves it out."""


def closing_lines(summary: dict[str, Any], directory: Path, recordings: Sequence[Path]) -> list[str]:
    """Return the lines that end a run on screen: what it found, how sure that is, then its time and files.

    Args:
        summary: of the run.
        directory: of its files.
        recordings: of the run, oldest first.
    """
    lines = [
        *(("tip", text) for text in tip_lines(summary["phases"])),
        *(("target", text) for text in target_lines(summary["phases"])),
        *(("object", text) for text in object_lines(summary["objects"])),
        ("films", films_line(summary)),
        ("error", error_line(summary)),
        ("stability", stability_line(summary)),
        ("modelled", modelled_line(summary)),
        ("warnings", warnings_line(summary)),
        ("time", time_line(summary)),
        ("files", files_line(directory, recordings)),
    ]
    return [f"{name + ':':<{_WIDTH}}{text}" for name, text in lines]


def quiet_line(summary: dict[str, Any], directory: Path) -> str:
    """Return the line that ends a quiet run."""
    parts = [_counted(len(summary["warnings"]), "warning")]
    parts += [_counted(len(summary["branchings"]), "branching")] if summary["branchings"] else []
    depth_m = max((row["depth_m"] for row in summary["overlaps"]), default=None)
    parts += [] if depth_m is None else [f"films overlap by {1e3 * depth_m:.2g} mm"]
    return f"{summary['status']}, {', '.join(parts)}: {directory}"


def modelled_line(summary: dict[str, Any]) -> str:
    """Return what is modelled, and what is left out."""
    rows = summary["modelled"]
    modelled, left = ([row["what"] for row in rows if row["included"] is shown] for shown in (True, False))
    return f"{', '.join(modelled) or 'nothing'}; left out: {', '.join(left) or 'nothing'}"


def stability_line(summary: dict[str, Any]) -> str:
    """Return a text on unstable states of the soft robot; without any, on its lowest frequency."""
    rows = summary["branchings"]
    lines = [*branching_lines(rows), *undecided_warnings(rows), *stability_lines(summary["phases"])]
    if lines:
        more = f"; {len(lines) - 1} more: branchings in the summary" if len(lines) > 1 else ""
        return lines[0] + more
    known = [phase for phase in summary["phases"] if phase["lowest_frequency_Hz"] is not None]
    if not known:
        return "no unstable state was found; no natural frequency is known"
    lowest = min(known, key=lambda phase: float(phase["lowest_frequency_Hz"]))
    frequency = f"{lowest['lowest_frequency_Hz']:.3g} Hz (phase '{lowest['name']}')"
    return f"no unstable state was found; lowest natural frequency {frequency}"


def tip_lines(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a text on the end of the last phase: tip, sag, length and tension with bars; empty without any.

    Args:
        phases: of the summary.
    """
    if not phases or None in (last := phases[-1])["tip_position_m"]:
        return []
    bars = last["error"] or {}
    tip, sag, length = (_bar(bars, key) for key in ("tip_m", "sag_m", "length_m"))
    place = ", ".join(f"{round(value, 3) + 0.0:.3f}" for value in last["tip_position_m"])  # + 0.0: no -0
    texts = [f"at {place} m{tip}"]
    texts += [] if last["sag_m"] is None else [f"sag {1e3 * last['sag_m']:.1f}{sag} mm"]
    texts += [] if last["length_m"] is None else [f"length {1e3 * last['length_m']:.4g}{length} mm"]
    tensions = [tension for tension in last["cable_tension_N"] or () if tension is not None]
    if tensions:
        pull = f"up to {max(tensions):.3g}{_bar(bars, 'cable_tension_N')} N" if any(tensions) else "slack"
        texts.append(f"cables {pull}")
    return [f"{', '.join(texts)}, at the end of '{last['name']}'"]


def films_line(summary: dict[str, Any]) -> str:
    """Return whether films pass through one another, press on one another, or keep apart."""
    lines = overlap_lines(summary["overlaps"])
    if lines:
        return lines[0]
    force_N, depth_m = summary["max_self_contact_force_N"], summary["max_self_contact_depth_m"]
    if force_N:
        return f"press on one another with up to {force_N:.3g} N and yield by {1e3 * depth_m:.2g} mm"
    row = next((row for row in summary["modelled"] if row["what"] == _ITSELF), None)
    if row is None or (row["included"] and summary["section_model"] is None):
        return "do not touch one another"
    return f"no overlap was found; {_ITSELF}: {row['reason']}"


def error_line(summary: dict[str, Any]) -> str:
    """Return the largest error bar of each figure over the phases, or why bars are missing."""
    rows = [(phase["name"], phase["error"]) for phase in summary["phases"] if phase["error"] is not None]
    texts = []
    for key, (name, unit, scale) in BARS.items():
        known = {phase: scale * row[key] for phase, row in rows if row[key] is not None}
        if known:
            worst = max(known, key=lambda phase: known[phase])
            texts.append(f"{name} {known[worst]:.2g} {unit} ('{worst}')")
    without = dict[str, list[str]]()
    for phase, row in rows:
        if row["reason"]:
            without.setdefault(row["reason"], []).append(f"'{phase}'")
    more = [f"no bar in {_some(phases)}: {why}" for why, phases in without.items()]
    reason = summary["error"]["reason"]
    left = [reason if texts else f"not computed: {reason}"] if reason else []
    longer_s = summary["error"].get("longer_tick_s")
    would_do = [f"clock.tick_s = {longer_s:g} is short enough for this mesh"] if longer_s else []
    return "; ".join([*([", ".join(texts)] if texts else []), *more, *left, *would_do])


def warnings_line(summary: dict[str, Any]) -> str:
    """Return the number of warnings, and the first one that was not shown before the run."""
    texts = summary["warnings"]
    if not texts:
        return "none"
    first = next((text for text in texts if not text.startswith(PLANNED)), texts[0])
    return f"1: {first}" if len(texts) == 1 else f"{len(texts)}, all in the summary; {first}"


def time_line(summary: dict[str, Any]) -> str:
    """Return how a run ended, and where its time went."""
    command_s, bars_s = summary["command_s"], summary["error"]["wall_s"]
    factor = summary["simulated_s"] / command_s if command_s > 0.0 else 0.0
    spent = [f"start {summary['startup_s']:.1f} s", f"ticks {summary['wall_s']:.1f} s"]
    spent += [f"error bars {bars_s:.1f} s"] if bars_s > 0.0 else []
    if summary["compiling_s"] >= _LEAST_COMPILING_S:
        spent.append(f"{summary['compiling_s']:.0f} s of it compiling, once per machine")
    return (
        f"{summary['status']}, {summary['simulated_s']:.2f} s in {command_s:.2f} s ({', '.join(spent)}; "
        f"x{factor:.2f} real time)"
    )


def files_line(directory: Path, recordings: Sequence[Path]) -> str:
    """Return a text on the files of a run."""
    names = ["summary.json", *(path.name for path in recordings[-1:])]
    view = f"; open it: cosim view {directory}" if recordings else ""
    return f"{directory}: {', '.join(names)}{view}"


def target_lines(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the tip's largest distance from its targets over the phases; empty without any.

    Args:
        phases: of the summary.
    """
    texts = []
    for key, scale, unit in (("tip_error_m", 1e3, "mm"), ("tip_angle_error_rad", 180.0 / math.pi, "degrees")):
        known = {phase["name"]: phase[key] for phase in phases if phase.get(key) is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            texts.append(f"{scale * known[worst]:.3g} {unit} (phase '{worst}')")
    return [f"tip off by {' and '.join(texts)}"] if texts else []


def _bar(bars: dict[str, Any], key: str) -> str:
    """Return the error bar of a figure as a text, in the unit of the line; empty without one."""
    scale = BARS[key][2]
    size = bars.get(key)
    unit = " mm" if key == "tip_m" else ""
    return "" if size is None else f" +-{scale * size:.2g}{unit}"


def _some(names: Sequence[str]) -> str:
    """Return the first names, and the number of the others."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _counted(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'s'[: count != 1]}"
