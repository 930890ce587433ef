"""Names that stand for several things: groups ("gripper" for "gripper/...") and patterns ("copy_*/tip")."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the names that a name, group or pattern stands for, in their order."""
    return [name for name in names if name.startswith(f"{pattern}/") or fnmatchcase(name, pattern)]
