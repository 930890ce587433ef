"""Cable tensions that a scenario gives by name: tables become lists when the scenario is resolved.

`cable_tension_N = { right = 8.0, gripper = 1.5 }` names cables, groups ("gripper" for all whose names begin
with "gripper/") or patterns; what it leaves out stays as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeVar

from cosim.config.schema.name_patterns import by_name
from cosim.config.schema.phase import PhaseTable, StartTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults, copy_with
from cosim.errors import ScenarioError

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
