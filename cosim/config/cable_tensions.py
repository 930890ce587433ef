"""Turns cable tensions that a scenario gives by name into lists with a tension for each cable. In
`cable_tension_N = { right = 8.0, gripper = 1.5 }` a key is a cable, a group ("gripper" for all cables whose
names begin with "gripper/") or a pattern ("copy_*/tip"). A cable that the table omits keeps its tension of
the previous phase.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar

from cosim.config.schema.named_values import by_name
from cosim.config.schema.phase import PhaseTable, StartTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.rules import Faults
from cosim.errors import ScenarioError

Table = TypeVar("Table", StartTable, PhaseTable)
_KEY: Final = "cable_tension_N"


def with_listed_tensions(scenario: Scenario, faults: Faults) -> Scenario:
    """Return a scenario whose start and phases give tensions as lists; omitted ones at the start are zeros.

    Args:
        scenario: as its file gives it.
        faults: gets names that match no cable, and omitted tensions whose previous value is unknown.
    """
    cables = scenario.soft_robot.cable_names()
    none = (0.0,) * len(cables)
    start, phases = scenario.start, []
    with faults:
        start = _with_list(start, none, cables, "start")
        start = replace(start, cable_tension_N=start.cable_tension_N or none)
    before: tuple[float, ...] | None = start.cable_tension_N
    for phase in scenario.phases:
        listed = phase
        with faults:
            listed = _with_list(phase, before, cables, f"phase.{phase.name}")
            before = before if listed.cable_tension_N is None else listed.cable_tension_N
            if listed.tip_target is not None and listed.tip_target.reach_with == "cables":
                before = None
        phases.append(listed)
    return replace(scenario, start=start, phases=tuple(phases))


def _with_list(table: Table, before: tuple[float, ...] | None, cables: Sequence[str], path: str) -> Table:
    """Return a start or phase whose tensions are a list, or None.

    Args:
        table: of the start or the phase.
        before: (cables,) [N], tensions at the end of the previous phase; None: unknown.
        cables: names of all cables.
        path: of the table, for messages.

    Raises:
        ScenarioError: a name matches no cable, or an omitted tension is unknown.
    """
    tensions: Any = table.cable_tension_N
    if not isinstance(tensions, Mapping):
        return table
    named = by_name(tensions, cables, "cable", f"{path}.{_KEY}")
    missing = [name for name in cables if name not in named]
    if missing and (before is None or len(before) != len(cables)):
        raise ScenarioError(
            f"{path}.{_KEY}",
            f"omits {missing[0]}, whose tension in the previous phase is unknown; name all cables",
        )
    by_cable = dict(zip(cables, before or (), strict=False)) | named
    return replace(table, cable_tension_N=tuple(by_cable[name] for name in cables))
