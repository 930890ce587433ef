"""Cable tensions that a scenario gives by name: tables become lists before the scenario is read.

`cable_tension_N = { right = 8.0, gripper = 1.5 }` names cables, groups ("gripper" for all whose names begin
with "gripper/") or patterns; what it leaves out stays as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cosim.config.schema.name_patterns import by_name
from cosim.config.toml.parsing import join, label
from cosim.errors import ScenarioError

_KEY = "cable_tension_N"


def list_tensions(table: Mapping[str, Any], names: Callable[[], Sequence[str]]) -> None:
    """Replace the tables of tensions of a scenario's start and phases by lists, in place.

    Args:
        table: of the scenario; what is not as it should be is left to be refused when it is read.
        names: returns those of all cables of its soft robot; asked only where there is such a table.

    Raises:
        ScenarioError: a name stands for no cable, or the tensions before are not known.
    """
    entries = [("start", table.get("start")), *_phases(table.get("phase"))]
    if not any(isinstance(entry, dict) and isinstance(entry.get(_KEY), Mapping) for _, entry in entries):
        return
    cables = names()
    before: Any = [0.0] * len(cables)
    for path, entry in entries:
        if not isinstance(entry, dict):
            continue
        if isinstance(entry.get(_KEY), Mapping):
            entry[_KEY] = _listed(entry[_KEY], before, cables, f"{path}.{_KEY}")
        before = entry.get(_KEY, before)
        target = entry.get("tip_target")
        if isinstance(target, Mapping) and target.get("reach_with") == "cables":
            before = None


def _phases(phases: Any) -> list[tuple[str, Any]]:
    """Return (path, table) of each phase."""
    entries = phases if isinstance(phases, list) else []
    return [(join("phase", label(entry, place)), entry) for place, entry in enumerate(entries, start=1)]


def _listed(given: Mapping[str, Any], before: Any, cables: Sequence[str], path: str) -> list[Any]:
    found = by_name(given, cables, "cable", path)
    missing = [name for name in cables if name not in found]
    if missing and not (isinstance(before, list) and len(before) == len(cables)):
        raise ScenarioError(
            path, f"leaves out {missing[0]}, whose tension before is not known here; name all cables"
        )
    return [found.get(name, old) for name, old in zip(cables, before or cables, strict=True)]
