"""What a run says at its end, from the summary alone; which model stood for the soft robot when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from cosim.coupling.soft_sides.handover import BridgeEnd, Handover
from cosim.plan.arm_limits import PLANNED
from cosim.telemetry.figures import branching_lines, overlap_lines, standing_lines, undecided_warnings


def with_handovers(
    known: list[dict[str, Any]], phase: str, time_s: float, passed: tuple[Handover | BridgeEnd, ...]
) -> list[dict[str, Any]]:
    """Return the changes so far with those of a tick.

    Args:
        known: so far.
        phase: its name.
        time_s: at the end of the tick.
        passed: in the tick.
    """
    found = list(known)
    for each in passed:
        if isinstance(each, BridgeEnd):
            if found:
                found[-1] = found[-1] | {"faded_s": time_s, "bridge_J": each.work_J}
            continue
        found.append(
            {
                "time_s": time_s,
                "phase": phase,
                "to": each.to,
                "why": each.why,
                "tip_jump_m": each.tip_jump_m,
                "force_gap_N": each.force_gap_N,
                "wrench_gap": each.wrench_gap,
                "kinetic_jump_J": each.kinetic_jump_J,
                "pressure_jump_Pa": each.pressure_jump_Pa,
                "touched_gap_N": each.touched_gap_N,
                "faded_s": None,
                "bridge_J": None,
            }
        )
    return found


def handover_figures(changes: list[dict[str, Any]], end_s: float) -> dict[str, Any]:
    """Return the changes, and how long which model stood for the soft robot.

    Args:
        changes: of `with_handovers`.
        end_s: of the run.
    """
    model, since, lasted = "section", 0.0, {"section": 0.0, "film": 0.0}
    for change in [*changes, {"to": "", "time_s": end_s}]:
        lasted[model] += change["time_s"] - since
        model, since = change["to"], change["time_s"]
    return {"section_s": lasted["section"], "film_s": lasted["film"], "changes": changes}


def handover_line(found: dict[str, Any]) -> str:
    """Return in a line which model stood for the soft robot when, and by how much models jumped.

    Args:
        found: of `handover_figures`.
    """
    changes = found["changes"]
    if not changes:
        return "none: the section model held throughout"
    times = [f"{change['to']} from {change['time_s']:.4g} s" for change in changes[:_LISTED]]
    more = f", {len(changes) - _LISTED} more changes" if len(changes) > _NAMED else ""
    first = next(change for change in changes if change["to"] == "film")
    jumps = _largest(changes, "tip_jump_m"), _largest(changes, "wrench_gap")
    return (
        f"{', '.join(times)}{more}; film for {found['film_s']:.3g} s, first as {first['why']}; "
        f"the tip jumps by up to {1e3 * jumps[0]:.2g} mm; {1e2 * jumps[1]:.2g} % of the wrench bridged"
    )


_LISTED = 4


def _largest(changes: list[dict[str, Any]], key: str) -> float:
    known = [change[key] for change in changes if change[key] is not None and math.isfinite(change[key])]
    return max(known, default=0.0)


_ITSELF: Final = "contact with itself"
_ERRORS: Final = {
    "tip_m": ("tip", "mm", 1e3),
    "sag_m": ("sag", "mm", 1e3),
    "length_m": ("length", "mm", 1e3),
    "volume_m3": ("volume", "cm^3", 1e6),
    "cable_tension_N": ("tension", "N", 1.0),
    "peak_strain": ("strain of frames", "%", 1e2),
}
"""Of each figure that has a bar: name, unit, and how many of it are one in SI."""
_NAMED: Final = 3
"""Phases that a line names, the rest are counted."""
_WIDTH: Final = len("stability: ")


def closing_lines(summary: dict[str, Any], directory: Path, recordings: Sequence[Path]) -> list[str]:
    """Return the six lines that end a run on screen; with a handover one more.

    Args:
        summary: of the run.
        directory: that its files are in.
        recordings: those of the run, oldest first.
    """
    lines = {
        "modelled": modelled_line(summary),
        "stability": stability_line(summary),
        "overlap": overlap_line(summary),
        **({"handover": handover_line(summary["handover"])} if summary["handover"] else {}),
        "error": error_line(summary),
        "warnings": warnings_line(summary),
        "files": files_line(summary, directory, recordings),
    }
    return [f"{name + ':':<{_WIDTH}}{text}" for name, text in lines.items()]


def quiet_line(summary: dict[str, Any], directory: Path) -> str:
    """Return the one line that ends a run where nothing else is shown."""
    found = [_counted(len(summary["warnings"]), "warning")]
    found += [_counted(len(summary["branchings"]), "branching")] if summary["branchings"] else []
    depth_m = max((row["depth_m"] for row in summary["overlaps"]), default=None)
    found += [] if depth_m is None else [f"films overlap by {1e3 * depth_m:.2g} mm"]
    return f"{summary['status']}, {', '.join(found)}: {directory}"


def modelled_line(summary: dict[str, Any]) -> str:
    """Return what was modelled, and what was left out."""
    rows = summary["modelled"]
    modelled, left = ([row["what"] for row in rows if row["included"] is kept] for kept in (True, False))
    return f"{', '.join(modelled) or 'nothing'}; left out: {', '.join(left) or 'nothing'}"


def stability_line(summary: dict[str, Any]) -> str:
    """Return where the soft robot was unstable, and how it was continued; else its lowest frequency."""
    rows = summary["branchings"]
    lines = [*branching_lines(rows), *undecided_warnings(rows), *standing_lines(summary["phases"])]
    if lines:
        more = f"; {len(lines) - 1} more: branchings in the summary" if len(lines) > 1 else ""
        return lines[0] + more
    known = [phase for phase in summary["phases"] if phase["lowest_frequency_Hz"] is not None]
    if not known:
        return "no unstable state was seen; no natural frequency is known"
    lowest = min(known, key=lambda phase: float(phase["lowest_frequency_Hz"]))
    frequency = f"{lowest['lowest_frequency_Hz']:.3g} Hz (phase '{lowest['name']}')"
    return f"no unstable state was seen; lowest natural frequency {frequency}"


def overlap_line(summary: dict[str, Any]) -> str:
    """Return whether films passed through one another, or how hard they press where that is modelled."""
    lines = overlap_lines(summary["overlaps"])
    if lines:
        return lines[0]
    force_N, depth_m = summary["max_self_contact_force_N"], summary["max_self_contact_depth_m"]
    if force_N:
        return f"none: films press on one another with up to {force_N:.3g} N, {1e3 * depth_m:.2g} mm deep"
    row = next((row for row in summary["modelled"] if row["what"] == _ITSELF), None)
    if row is None or (row["included"] and summary["section_model"] is None):
        return "none: films do not touch one another"
    return f"none was seen; {_ITSELF}: {row['reason']}"


def error_line(summary: dict[str, Any]) -> str:
    """Return how far each figure may be off, the largest over the phases; or why that is not known."""
    rows = [(phase["name"], phase["error"]) for phase in summary["phases"] if phase["error"] is not None]
    texts = []
    for key, (name, unit, scale) in _ERRORS.items():
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
    left = [reason if texts else f"not worked out: {reason}"] if reason else []
    return "; ".join([*([", ".join(texts)] if texts else []), *more, *left])


def warnings_line(summary: dict[str, Any]) -> str:
    """Return how many there are, and the first that has not been shown before the run."""
    texts = summary["warnings"]
    if not texts:
        return "none"
    first = next((text for text in texts if not text.startswith(PLANNED)), texts[0])
    return f"1: {first}" if len(texts) == 1 else f"{len(texts)}, all in the summary; {first}"


def files_line(summary: dict[str, Any], directory: Path, recordings: Sequence[Path]) -> str:
    """Return how the run ended, and what it left."""
    factor = summary["real_time_factor"] or 0.0
    names = ["summary.json", *(path.name for path in recordings[-1:])]
    look = f"; open it: cosim view {directory}" if recordings else ""
    return (
        f"{directory}: {', '.join(names)}{look}; {summary['status']}, {summary['simulated_s']:.2f} s in "
        f"{summary['wall_s']:.2f} s (x{factor:.2f} real time)"
    )


def _some(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _counted(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'s'[: count != 1]}"


def swing_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the first phase whose lowest mode cannot swing, as the integrator stops it.

    Within one period that takes nine tenths of its amplitude, and more than what is declared.

    Args:
        phases: of the summary.
    """
    for phase in phases:
        for mode in phase.get("modes", ())[:1]:
            frequency, numerical = mode["frequency_Hz"], mode["numerical_decay_per_s"] or 0.0
            if numerical > max(mode["declared_decay_per_s"] or 0.0, math.log(10.0) * frequency):
                return [
                    f"phase '{phase['name']}': the soft robot cannot swing at its lowest frequency, "
                    f"{frequency:.3g} Hz: ticks damp it by {numerical:.2g} per s; use solver.integrator = "
                    "'bdf2' or a shorter clock.tick_s"
                ]
    return []


def swing_lines(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the natural modes of the phase with the lowest frequency; none are known: nothing.

    Args:
        phases: of the summary.
    """
    known = [phase for phase in phases if phase.get("modes")]
    if not known:
        return []
    phase = min(known, key=lambda phase: float(phase["modes"][0]["frequency_Hz"]))
    modes = phase["modes"]
    frequencies = ", ".join(f"{mode['frequency_Hz']:.3g}" for mode in modes)
    text = f"{frequencies} Hz (phase '{phase['name']}')"
    if modes[0]["declared_decay_per_s"] is None:
        return [text]
    declared, numerical = (
        ", ".join(f"{mode[key]:.2g}" for mode in modes)
        for key in ("declared_decay_per_s", "numerical_decay_per_s")
    )
    return [f"{text}; they decay at {declared} per s as declared, and by ticks at {numerical} more"]
