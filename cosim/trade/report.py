"""A trade as Markdown and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from cosim import __version__
from cosim.trade.choice import Wish, candidates, pareto_front, pick
from cosim.trade.measuring import Measured

GROUPS = {
    "time": "Fidelity, and how time is stepped",
    "model": "What is modelled (all at one tick)",
}
_HEAD = "| | member | real-time factor | tip, largest [mm] | tip, rms [mm] | tip, phase ends [mm] | force, largest [N] | contact, rms [N] | iterations a tick |"  # noqa: E501
_RULE = "|---|---|---:|---:|---:|---:|---:|---:|---:|"


def markdown(title: str, results: Sequence[Measured]) -> str:
    """Return the tables of all groups; members on the Pareto front have a star."""
    lines = [f"# Speed against accuracy: {title}", ""]
    lines += [
        "Errors are against the reference of each table (marked ref), sampled every 20 ms of the run. The",
        "real-time factor is simulated time over CPU time of the loop, without recording. A star: no other",
        "member of the table is both faster and nearer to the reference.",
    ]
    for group, heading in GROUPS.items():
        members = [result for result in results if result.member.group == group]
        if members:
            lines += ["", f"## {heading}", "", _HEAD, _RULE, *_rows(members)]
    return "\n".join(lines) + "\n"


def _rows(results: Sequence[Measured]) -> list[str]:
    front = pareto_front(results)
    rows = []
    for result in results:
        mark = "ref" if result.member.reference else "*" if result in front else ""
        if result.failure:
            rows.append(f"| {mark} | {result.member.name} | failed: {_short(result.failure)} | | | | | | |")
            continue
        errors = [1e3 * result.tip_error_m, 1e3 * result.tip_rms_m, 1e3 * result.end_error_m,
                  result.force_error_N, result.contact_error_N]  # fmt: skip
        shown = [_number(error) if not result.member.reference else "" for error in errors]
        cells = [f"{result.real_time_factor:.2f}", *shown, f"{result.iterations:.2f}"]
        rows.append(f"| {mark} | {result.member.name} | " + " | ".join(cells) + " |")
    return rows


def _short(failure: str) -> str:
    """Return the first clause of a message; a table has no room for more."""
    return failure.split(";")[0].replace("|", "/")[:160]


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""


def choice_lines(results: Sequence[Measured], wish: Wish) -> str:
    """Return which member meets a wish, and how to run it."""
    found = pick(candidates(results), wish)
    if found is None:
        return f"No member meets {wish.words}."
    return (
        f"For {wish.words}: {found.member.name} (x{found.real_time_factor:.2f} real time, "
        f"{1e3 * found.tip_error_m:.3g} mm, {found.force_error_N:.3g} N). Run it with: {found.member.words}"
    )


def as_json(title: str, results: Sequence[Measured], wish: Wish | None) -> str:
    """Return everything as a JSON document; numbers that are not finite become null."""
    chosen = pick(candidates(results), wish) if wish else None
    fronts = [r for group in GROUPS for r in pareto_front([m for m in results if m.member.group == group])]
    document = {
        "cosim": __version__,
        "scenario": title,
        "choice": chosen.member.name if chosen else None,
        "members": [{**entry(result), "pareto": result in fronts} for result in results],
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def entry(result: Measured) -> dict[str, Any]:
    """Return a member and its figures in JSON's own kinds."""
    numbers = {
        name: value if math.isfinite(value) else None
        for name, value in vars(result).items()
        if isinstance(value, float)
    }
    member = result.member
    return {
        "name": member.name,
        "group": member.group,
        "reference": member.reference,
        "changes": dict(member.changes),
        **numbers,
        "failure": result.failure or None,
    }
