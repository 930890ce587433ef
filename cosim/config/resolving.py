"""Resolves what a scenario names, cable tensions and tip-path files, into values.

Cable tensions that a scenario gives by name: tables become lists when the scenario is resolved.

`cable_tension_N = { right = 8.0, gripper = 1.5 }` names cables, groups ("gripper" for all whose names begin
with "gripper/") or patterns; what it leaves out stays as it was.

Paths of the tip in a scenario's tables: read from their CSV files, with the time that they take.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from cosim.base.files_read import read_file
from cosim.config.schema.phase import MOST_POINTS, PhaseTable, StartTable, TipPathTable, by_name
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.parsing import parse
from cosim.config.toml.reading import LARGEST_FILE_BYTES, UNKNOWN, Faults, NotKnown, copy_with
from cosim.errors import InputError, ScenarioError

Table = TypeVar("Table", StartTable, PhaseTable)
_KEY: Final = "cable_tension_N"


def with_listed_tensions(scenario: Scenario, faults: Faults) -> Scenario:
    """Return a scenario whose start and phases give tensions as lists; omitted ones at the start are zeros.

    Args:
        scenario: as its file gives it.
        faults: gets names that stand for no cable, and tensions that are not known before.
    """
    cables = scenario.soft_robot.cable_names()
    before: tuple[float, ...] | None = (0.0,) * len(cables)
    start, phases = scenario.start, []
    with faults:
        start = _with_list(start, before, cables, "start")
        before = start.cable_tension_N or before
        start = copy_with(start, cable_tension_N=before)
    for phase in scenario.phases:
        listed = phase
        with faults:
            listed = _with_list(phase, before, cables, f"phase.{phase.name}")
            before = before if listed.cable_tension_N is None else listed.cable_tension_N
            if listed.tip_target is not None and listed.tip_target.reach_with == "cables":
                before = None
        phases.append(listed)
    return copy_with(scenario, start=start, phases=tuple(phases))


def _with_list(table: Table, before: tuple[float, ...] | None, cables: Sequence[str], path: str) -> Table:
    """Return a start or phase whose tensions are a list, or None.

    Raises:
        ScenarioError: a name stands for no cable, or the tensions before are not known.
    """
    given: Any = table.cable_tension_N
    if not isinstance(given, Mapping):
        return table
    found = by_name(given, cables, "cable", f"{path}.{_KEY}")
    missing = [name for name in cables if name not in found]
    if missing and (before is None or len(before) != len(cables)):
        raise ScenarioError(
            f"{path}.{_KEY}",
            f"leaves out {missing[0]}, whose tension before is not known here; name all cables",
        )
    tensions = dict(zip(cables, before or (), strict=False)) | found
    return copy_with(table, cable_tension_N=tuple(tensions[name] for name in cables))


_POINT: Final = ("x_m", "y_m", "z_m")
_DIRECTION: Final = ("direction_x", "direction_y", "direction_z")


def complete_tip_paths(table: dict[str, Any], folder: Path, faults: Faults) -> None:
    """Put into each phase that has a tip path the path's points, its duration and its ramp.

    Args:
        table: of a scenario, as TOML gives it; changed in place.
        folder: that files of points are relative to.
        faults: gets files that cannot be read.
    """
    phases = table.get("phase")
    if "tip_path" not in str(phases):  # as in most scenarios: their phases are not looked into
        return
    for place, phase in enumerate(phases if isinstance(phases, list) else [], start=1):
        path = phase.get("tip_path") if isinstance(phase, dict) else None
        if isinstance(path, dict):
            phase["tip_path"] = UNKNOWN
            with faults:
                phase["tip_path"] = _read(path, folder, f"phase.{phase.get('name', place)}.tip_path")
            phase.setdefault("ramp", "linear")
            if "duration_s" not in phase:
                phase["duration_s"] = _duration_s(phase["tip_path"])


def _duration_s(path: Any) -> Any:
    """Return how long a path takes; UNKNOWN for one that is wrong, which is told where it is checked."""
    if path is UNKNOWN:
        return UNKNOWN
    try:
        return parse(TipPathTable, path, "", Faults()).course().duration_s
    except (InputError, NotKnown):
        return UNKNOWN


def _read(path: dict[str, Any], folder: Path, key: str) -> dict[str, Any]:
    """Return the table of a path with points and directions in place of its file."""
    if not isinstance(path.get("file"), str):
        return path
    for given in ("points_m", "directions"):
        if given in path:
            raise ScenarioError(f"{key}.{given}", "cannot stand beside file, which gives the points")
    points, directions = read_tip_path(folder / path["file"], f"{key}.file")
    kept = {name: value for name, value in path.items() if name != "file"}
    return {**kept, "points_m": points, **({"directions": directions} if directions else {})}


def read_tip_path(file: Path, key: str) -> tuple[list[list[float]], list[list[float]]]:
    """Return points [m] and directions of a CSV file; the latter empty where it has none.

    Args:
        file: with a header that names its columns; lines that begin with # are left out.
        key: of the scenario that names it.

    Raises:
        ScenarioError: it cannot be read, or lacks columns or numbers.
    """
    try:
        data = read_file(file, LARGEST_FILE_BYTES)
        if len(data) > LARGEST_FILE_BYTES:
            raise ScenarioError(
                key, f"{file.name} is longer than {LARGEST_FILE_BYTES} bytes; take fewer points"
            )
        text = data.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ScenarioError(key, f"{str(file)!r} cannot be read: {reason}") from error
    lines = [
        (k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] != "#"
    ]
    rows = [(k, [cell.strip() for cell in next(csv.reader([line]))]) for k, line in lines]
    header = rows[0][1] if rows else []
    known = (*_POINT, *_DIRECTION)
    wrong = [name for name in header if name not in known or header.count(name) > 1]
    lacks = [name for name in (known if set(header) & set(_DIRECTION) else _POINT) if name not in header]
    if wrong or lacks:
        problem = f"has the column {wrong[0]!r}" if wrong else f"lacks the column {lacks[0]}"
        raise ScenarioError(
            key,
            f"{file.name} {problem}; its header names {', '.join(_POINT)}, and for directions "
            f"{', '.join(_DIRECTION)}",
        )
    if len(rows) - 1 > MOST_POINTS:
        raise ScenarioError(key, f"{file.name} has {len(rows) - 1} points; at most {MOST_POINTS} are read")
    numbers = [_numbers(row, len(header), f"{file.name}, line {k}", key) for k, row in rows[1:]]
    found = [dict(zip(header, row, strict=True)) for row in numbers]
    points = [[row[name] for name in _POINT] for row in found]
    return points, [[row[name] for name in _DIRECTION] for row in found if _DIRECTION[0] in row]


def _numbers(row: list[str], count: int, place: str, key: str) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError as error:
        raise ScenarioError(key, f"{place}: {error}") from error
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ScenarioError(key, f"{place}: {', '.join(row)!r} must be {count} finite numbers")
    return values
