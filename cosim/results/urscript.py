"""A motion as URScript: a move to its start, then `servoj` at every step. The payload, if it is known, is set
by `set_target_payload` before the move, and every 0.5 s to its value 0.5 s later (PolyScope 5.10 and later);
when an object is grasped or released, it is set at once, with a comment.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.telemetry.held_parts import HeldPart

UPDATE_EVERY_s: Final = 0.5
"""Time between two updates of the payload; the controller interpolates in between."""
_LOOKAHEAD_s: Final = 0.1
_GAIN: Final = 300
_ROUNDING_s: Final = 1e-9
_APPROACH: Final = "a=0.5, v=0.3"
_STOP_rad_s2: Final = 2.0


def program(
    name: str,
    joint_names: Sequence[str],
    time_s: Array,
    joints: Array,
    payload: Array | None,
    held: Sequence[HeldPart],
) -> str:
    """Return the program of a motion.

    Args:
        name: of the phase, or of the scenario.
        joint_names: base to flange.
        time_s: (n,), evenly spaced.
        joints: (n, joints) [rad].
        payload: (n, 10), as `joint_table.PAYLOAD`; None: unknown.
        held: held objects, with times.
    """
    step_s = float(time_s[1] - time_s[0])
    end = f"0, 0, {step_s:.9g}, {_LOOKAHEAD_s:g}, {_GAIN}"
    rows = ["[" + ", ".join(f"{angle:.9f}" for angle in row) + "]" for row in joints.tolist()]
    before_move, updates = list[str](), dict[int, list[str]]()
    if payload is not None:
        changes = _changes(time_s, payload, held)
        before_move = [f"  # {changes[0]}"] if 0 in changes else []
        before_move.append(_payload_call(payload[0], 0.0))
        updates = _payload_updates(payload, changes, step_s)
    calls = [line for k, row in enumerate(rows) for line in (*updates.get(k, ()), f"  servoj({row}, {end})")]
    return "\n".join(
        [
            f"# phase {name}: {len(rows)} points, {step_s:.9g} s apart; joints {', '.join(joint_names)}",
            f"def {_identifier(name)}():",
            *before_move,
            f"  movej({rows[0]}, {_APPROACH})",
            *calls,
            f"  stopj({_STOP_rad_s2:g})",
            "end",
            "",
        ]
    )


def _identifier(name: str) -> str:
    """Return a name as URScript allows for a function: ASCII letters, digits and '_', a letter first."""
    valid = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return valid if valid[:1].isalpha() else f"p_{valid}"


def _payload_updates(payload: Array, changes: dict[int, str], step_s: float) -> dict[int, list[str]]:
    """Return the lines that update the payload, by the row that they precede.

    Args:
        payload: (n, 10).
        changes: comment on grasped and released objects, by row, in order.
        step_s: between two rows.
    """
    lines: dict[int, list[str]] = {}
    every, last = max(round(UPDATE_EVERY_s / step_s), 1), len(payload) - 1
    edges = [*(k for k in changes if k), last + 1]
    for first, end in pairwise([0, *edges]):
        if first:
            lines.setdefault(first, []).extend([f"  # {changes[first]}", _payload_call(payload[first], 0.0)])
        for k in range(first, min(end, last), every):
            to = min(k + every, end - 1)
            within_s = (to - k if end <= last else every) * step_s
            if to > k:
                lines.setdefault(k, []).append(_payload_call(payload[to], within_s))
    return lines


def _changes(time_s: Array, payload: Array, held: Sequence[HeldPart]) -> dict[int, str]:
    """Return a comment on grasped and released objects, by row, in order."""
    texts: dict[int, list[str]] = {}
    times = time_s + _ROUNDING_s
    for part in held:
        what = f"'{part.name}', {part.mass_kg:.4g} kg"
        for verb, at_s in (("takes", part.since_s), ("lets go of", part.until_s)):
            row = int(np.searchsorted(times, at_s))
            if at_s > 0.0 and row < len(times):
                texts.setdefault(row, []).append(f"{verb} {what}")
        if part.since_s <= 0.0:
            texts.setdefault(0, []).append(f"holds {what}")
    return {
        row: f"{'; '.join(texts[row])}: payload {payload[row, 0]:.4g} kg, "
        f"{payload[max(row - 1, 0), 0]:.4g} kg until here"
        for row in sorted(texts)
    }


def _payload_call(row: Array, within_s: float) -> str:
    mass, *others = (f"{value:.6g}" for value in row.tolist())
    return f"  set_target_payload({mass}, [{', '.join(others[:3])}], [{', '.join(others[3:])}], {within_s:g})"
