"""Sentences on branchings and on the stability at the ends of phases, from the rows of a summary."""

import math
from collections.abc import Sequence
from typing import Any, Final

from cosim.soft.solve.branching import IN_TIME, WHOLE

_SYMMETRIC_m: Final = 1e-3
"""Distance of the tip on both sides of a branching, below which they are symmetric."""


def undecided_warnings(branchings: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on each unstable state in motion in which more than a wrinkle moves."""
    return [
        f"{_where(row)}; the run was there from {row['time_s']:.4g} to {row['until_s']:.4g} s, and "
        f"{row['chosen']}{_rest(row)}"
        for row in branchings
        if row["chosen"] in IN_TIME and row["extent"] >= WHOLE
    ]


def branching_lines(branchings: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on each large branching in statics, and one on those that move little.

    Args:
        branchings: of the summary.
    """
    small = [row for row in branchings if row["extent"] < WHOLE or _is_symmetric(row)]
    lines = [_branching_line(row) for row in branchings if row["chosen"] not in IN_TIME and row not in small]
    little = f"{len(small)} branchings of wrinkles, or to symmetric sides: see branchings in summary.json"
    return [*lines, little] if small else lines


def _is_symmetric(row: dict[str, Any]) -> bool:
    """Return whether both sides of a branching hardly differ, as of a stack that may lean to any side."""
    sides = row["tip_m"], row["other_tip_m"]
    return not row["snap"] and None not in sides and math.dist(*sides) < _SYMMETRIC_m


def _rest(row: dict[str, Any]) -> str:
    if row["tip_m"] is None:
        return ""
    rest = f"; with the loads of its end, it comes to rest with its tip at {_position(row['tip_m'])}"
    return f"{rest}, one of several equilibria"


def stability_lines(phases: list[dict[str, Any]]) -> list[str]:
    """Return a sentence on each phase that ends unstable, or near an unstable state.

    Args:
        phases: of the summary.
    """
    lines = []
    for row in phases:
        stability, margin, tip_m = (row[name] for name in ("stability", "load_margin", "disturbed_tip_m"))
        if stability == "unstable":
            lines.append(f"phase '{row['name']}' ends unstable")
        elif stability == "undetermined":
            lines.append(
                f"phase '{row['name']}' may end unstable: its loads have no potential, the symmetric part "
                "of its tangent, losses held, is not positive definite"
            )
        elif stability is not None and stability.startswith("near"):
            most = (
                "" if margin is None else f"; it is unstable if all loads change by {100.0 * margin:+.2g} %"
            )
            lines.append(
                f"phase '{row['name']}' ends {stability}: a millionth of its loads moves the tip by "
                f"{1e3 * tip_m:.2g} mm{most}"
            )
    return lines


def _branching_line(row: dict[str, Any]) -> str:
    line, other = _where(row), row["other_tip_m"]
    if row["snap"] and row["tip_m"] is not None:
        return f"{line}, the tip from {_position(other)} to {_position(row['tip_m'])}: {row['chosen']}"
    if row["tip_m"] is None:
        return f"{line}; {row['chosen']}"
    opposite = "" if other is None else f"; on the other side it is at {_position(other)}"
    return f"{line}; tip at {_position(row['tip_m'])}: {row['chosen']}{opposite}"


def _where(row: dict[str, Any]) -> str:
    pressures = "/".join(f"{1e-3 * value:.4g}" for value in row["pressure_Pa"]) or "0"
    tensions = "/".join(f"{value:.4g}" for value in row["cable_tension_N"])
    loads = f"{pressures} kPa" + (f", cables at {tensions} N" if any(row["cable_tension_N"]) else "")
    direction = ", ".join(f"{round(value, 2) + 0.0:g}" for value in row["direction"])
    does, moves = "branches", f"moves along ({direction}) or against it"
    held = " (by the symmetric part of its tangent, with losses held)" if row["losses_held"] else ""
    if row["snap"]:
        does, moves = "snaps", f"moves along ({direction})"
    return (
        f"phase '{row['phase']}' {does} at {loads} ({100.0 * row['load_factor']:.3g} % of its load step): "
        f"{row['place']} {moves}{held}"
    )


def _position(position_m: Sequence[float]) -> str:
    return "(" + ", ".join(f"{1e3 * value:.1f}" for value in position_m) + ") mm"
