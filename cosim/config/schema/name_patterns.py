"""Names that stand for several things: groups ("gripper" for "gripper/...") and patterns ("copy_*/tip")."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import TypeVar

from cosim.config.toml.suggestions import unknown_name_message
from cosim.errors import ScenarioError

Value = TypeVar("Value")


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the names that a name, group or pattern stands for, in their order."""
    return [name for name in names if name.startswith(f"{pattern}/") or fnmatchcase(name, pattern)]


def by_name(table: Mapping[str, Value], names: Sequence[str], what: str, path: str) -> dict[str, Value]:
    """Return the value of each name that a table gives one by name, group or pattern; later entries win.

    Args:
        table: of a scenario.
        names: that there are.
        what: they are names of, for the message.
        path: of the table, for the message.

    Raises:
        ScenarioError: a key stands for no name.
    """
    found: dict[str, Value] = {}
    for key, value in table.items():
        meant = matching(key, names)
        if not meant:
            raise ScenarioError(f"{path}.{key}", unknown_name_message(what, key, tuple(names)))
        found.update(dict.fromkeys(meant, value))
    return found
