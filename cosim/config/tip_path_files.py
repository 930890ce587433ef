"""Reads the CSV files of tip paths into a scenario's tables, and sets duration and ramp of their phases."""

import csv
import math
from pathlib import Path
from typing import Any, Final

from cosim.base.files import read_text
from cosim.config.schema.phase import MOST_POINTS, TipPathTable
from cosim.config.toml import parsing
from cosim.config.toml.rules import Faults
from cosim.errors import InputError, ScenarioError

_POINT: Final = ("x_m", "y_m", "z_m")
_DIRECTION: Final = ("direction_x", "direction_y", "direction_z")


def read_tip_paths(table: dict[str, Any], folder: Path, faults: Faults) -> None:
    """Set points, duration and ramp in each phase that has a tip path.

    Args:
        table: of a scenario, as TOML gives it; changed in place.
        folder: that paths of CSV files start from.
        faults: gets files that cannot be read.
    """
    phases = table.get("phase")
    for place, phase in enumerate(phases if isinstance(phases, list) else [], start=1):
        path = phase.get("tip_path") if isinstance(phase, dict) else None
        if isinstance(path, dict):
            del phase["tip_path"]
            with faults:
                phase["tip_path"] = _read(path, folder, f"phase.{phase.get('name', place)}.tip_path")
            phase.setdefault("ramp", "linear")
            if "duration_s" not in phase:
                phase["duration_s"] = _duration_s(phase.get("tip_path", {}))


def _duration_s(path: dict[str, Any]) -> float:
    """Return the duration of a path [s]; 1 for a wrong path, which is reported by its own check."""
    try:
        return parsing.parse(TipPathTable, path, "", Faults()).course().duration_s
    except InputError:
        return 1.0


def _read(path: dict[str, Any], folder: Path, key: str) -> dict[str, Any]:
    """Return the table of a path with its file replaced by points and directions."""
    if not isinstance(path.get("file"), str):
        return path
    for given in ("points_m", "directions"):
        if given in path:
            raise ScenarioError(f"{key}.{given}", "cannot be combined with file, which gives the points")
    points, directions = read_tip_path(folder / path["file"], f"{key}.file")
    kept = {name: value for name, value in path.items() if name != "file"}
    return {**kept, "points_m": points, **({"directions": directions} if directions else {})}


def read_tip_path(file: Path, key: str) -> tuple[list[list[float]], list[list[float]]]:
    """Return the points [m] and directions of a CSV file; no directions if it has no such columns.

    Args:
        file: with a header that names its columns; lines that begin with # are skipped.
        key: of the scenario that names the file, for messages.

    Raises:
        ScenarioError: it cannot be read, or lacks columns or numbers.
    """
    try:
        text = read_text(file)
    except OSError as error:
        raise ScenarioError(key, f"{str(file)!r} cannot be read: {error.strerror}") from error
    lines = [
        (k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] != "#"
    ]
    try:
        rows = [(k, [cell.strip() for cell in next(csv.reader([line]))]) for k, line in lines]
    except csv.Error as error:
        raise ScenarioError(key, f"{file.name}: {error}") from error
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
