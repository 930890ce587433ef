"""Which model stood for the soft robot when, of runs that hand over between a section model and its film."""

from __future__ import annotations

import math
from typing import Any

from cosim.coupling.soft_sides.handover import BridgeEnd, Handover


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
    times = [f"{change['to']} from {change['time_s']:.4g} s" for change in changes[:_NAMED]]
    more = f", {len(changes) - _NAMED} more changes" if len(changes) > _NAMED else ""
    first = next(change for change in changes if change["to"] == "film")
    jumps = _largest(changes, "tip_jump_m"), _largest(changes, "wrench_gap")
    return (
        f"{', '.join(times)}{more}; film for {found['film_s']:.3g} s, first as {first['why']}; "
        f"the tip jumps by up to {1e3 * jumps[0]:.2g} mm; {1e2 * jumps[1]:.2g} % of the wrench bridged"
    )


_NAMED = 4


def _largest(changes: list[dict[str, Any]], key: str) -> float:
    known = [change[key] for change in changes if change[key] is not None and math.isfinite(change[key])]
    return max(known, default=0.0)
