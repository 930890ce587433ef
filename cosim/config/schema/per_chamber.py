"""Values that a scenario gives for the gas chambers: one for all, a list, or a table by name.

A name in a table is that of a chamber ("gripper/copy_2"), of a group of chambers ("gripper" for all whose
names begin with "gripper/"), or a pattern ("gripper/copy_*").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias, TypeVar

from cosim.config.schema.name_patterns import by_name
from cosim.config.toml.suggestions import listing
from cosim.errors import ScenarioError

Value = TypeVar("Value")
PerChamber: TypeAlias = Value | tuple[Value, ...] | Mapping[str, Value]


def given_values(
    setting: PerChamber[Value] | None, names: Sequence[str], path: str
) -> tuple[Value | None, ...]:
    """Return the value that a setting gives for each chamber; None where it leaves one out.

    Args:
        setting: of a scenario.
        names: of the chambers.
        path: of the setting, for messages.

    Raises:
        ScenarioError: a list of another length, or a name that stands for no chamber.
    """
    if isinstance(setting, Mapping):
        found = by_name(setting, names, "chamber", path)
        return tuple(found.get(name) for name in names)
    if not isinstance(setting, tuple):
        return (setting,) * len(names)
    if len(setting) != len(names):
        raise ScenarioError(
            path, f"has {len(setting)} entries; there are {len(names)} chambers: {listing(names)}"
        )
    return setting


def values_after(
    before: tuple[Value, ...], setting: PerChamber[Value] | None, names: Sequence[str], path: str
) -> tuple[Value, ...]:
    """Return the value of each chamber after a setting; what it leaves out stays as before.

    Raises:
        ScenarioError: see `given_values`.
    """
    given = given_values(setting, names, path)
    return tuple(old if new is None else new for old, new in zip(before, given, strict=True))
