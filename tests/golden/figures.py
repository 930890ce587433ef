"""Figures of a run: numbers by name, of its summary, its arrays at the ends of phases, and its recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from rerun.chunk import RrdReader

import cosim

Figures = dict[str, float]

TOTALS: Final = (
    "tick_s", "ticks", "simulated_s", "soft_weight_N", "max_stability_ratio", "contact_since_s",
    "max_contact_force_N", "max_contact_depth_m", "self_contact_since_s", "max_self_contact_force_N",
    "max_self_contact_depth_m", "touched", "objects",
)  # fmt: skip
"""Keys of the summary for a whole run."""
LEFT_OUT: Final = (
    "newton_iterations", "error", "disturbed_tip_m", "load_margin", "modes", "branchings", "numerical_J",
    "rest_J", "joint_position_rad", "sensor",
)  # fmt: skip
"""Keys of a phase that depend on the way to the state; and measured joints: their targets are recorded."""
_HALF_SPACE: Final = np.array([0.37, 0.59, 0.83, 0.23])
"""Of q and -q, one rotation, the one on this side is taken."""


def of_result(result: cosim.RunResult) -> Figures:
    """Return the figures of a run without those of its recording."""
    summary, bodies = result.summary, result.stage.body_names
    figures = flat("run", {key: summary[key] for key in TOTALS})
    touched = {_name(entry, 0) for key in ("touched", "objects") for entry in summary[key]}
    for number, phase in enumerate(summary["phases"]):
        row = np.flatnonzero(result.phase == number)[-1]
        entries = {key: value for key, value in phase.items() if key not in LEFT_OUT}
        entries["joint_target_rad"] = result.joint_target[row]
        for index, body in enumerate(bodies):
            if body in touched:
                entries[body] = {
                    "position_m": result.body_position[row, index],
                    "quaternion": result.body_quaternion[row, index],
                    "force_N": result.body_contact_force[row, index],
                }
        figures |= flat(phase["name"], entries)
    for kind in ("planned", "run"):
        for key, extreme in ((summary["arm"] or {}).get(kind) or {}).items():
            if isinstance(extreme, Mapping) and "value" in extreme:
                figures[f"arm.{kind}.{key}"] = float(extreme["value"])
    return figures


def of_recording(path: Path) -> Figures:
    """Return the number of frames of each entity of a recording, by its path."""
    frames: Figures = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_empty:
            name = f"frames of {chunk.entity_path}"
            frames[name] = frames.get(name, 0.0) + chunk.num_rows
    return frames


def flat(path: str, value: Any) -> Figures:
    """Return the numbers in a value, such as a matrix or a summary, by their path."""
    return dict(_flat(path, value))


def _flat(path: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a value by their path; lists of objects by the objects' names."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            if key not in LEFT_OUT:
                yield from _flat(f"{path}.{key}", entry)
    elif isinstance(value, list | tuple | np.ndarray):
        if path.endswith("quaternion"):
            value = np.asarray(value) * (1.0 if np.dot(value, _HALF_SPACE) > 0.0 else -1.0)
        for index, entry in enumerate(value):
            yield from _flat(f"{path}.{_name(entry, index)}", entry)
    elif value is not None and not isinstance(value, str):
        yield path, float(value)


def _name(entry: Any, index: int) -> str:
    """Return the name of an entry of a list: of an object or a body its own, else its place."""
    return str(entry.get("name", entry.get("body", index)) if isinstance(entry, Mapping) else index)
