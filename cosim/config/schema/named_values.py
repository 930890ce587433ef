"""Values that a scenario gives for its chambers, cables or joints: one for all, a list, or a table by name. A
key of a table is a name ("gripper/copy_2"), a group ("gripper" for all names that begin with "gripper/"), or
a pattern ("gripper/copy_*").
"""

from collections.abc import Mapping, Sequence
from typing import TypeVar

from cosim.config.toml.keys import listing, matching, unknown_name_message
from cosim.config.toml.quantities import OneOrByName
from cosim.errors import ScenarioError

Value = TypeVar("Value")


def by_name(table: Mapping[str, Value], names: Sequence[str], what: str, path: str) -> dict[str, Value]:
    """Return the value of each name that a table's keys match; later entries override earlier ones.

    Args:
        table: of a scenario: values by name, group or pattern.
        names: that exist.
        what: kind of the named things, such as "cable", for the message.
        path: of the table, for the message.

    Raises:
        ScenarioError: a key matches no name.
    """
    found: dict[str, Value] = {}
    for key, value in table.items():
        meant = matching(key, names)
        if not meant:
            raise ScenarioError(f"{path}.{key}", unknown_name_message(what, key, tuple(names)))
        found.update(dict.fromkeys(meant, value))
    return found


def given_values(
    setting: OneOrByName[Value] | None, names: Sequence[str], path: str
) -> tuple[Value | None, ...]:
    """Return the value that a setting gives for each chamber; None for a chamber that it omits.

    Args:
        setting: of a scenario.
        names: of the chambers.
        path: of the setting, for messages.

    Raises:
        ScenarioError: a list has another length, or a name matches no chamber.
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
    before: tuple[Value, ...], setting: OneOrByName[Value] | None, names: Sequence[str], path: str
) -> tuple[Value, ...]:
    """Return the value of each chamber after a setting; a chamber that it omits keeps its value.

    Args:
        before: (chambers,) values.
        setting: of a scenario.
        names: of the chambers.
        path: of the setting, for messages.

    Raises:
        ScenarioError: see `given_values`.
    """
    given = given_values(setting, names, path)
    return tuple(old if new is None else new for old, new in zip(before, given, strict=True))
