"""What a scenario may name of a soft body that is given from Python in place of a soft robot's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias, final

from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.constraints import Count, Name, Text


@final
@dataclass(frozen=True)
class GivenBodyTable:
    """A soft body given as arrays. It is written for the record; its shape and film are in no file.

    Args:
        name: of the body.
        arrays: short name of all that it is made of: equal bodies have equal ones.
        triangles: number of film triangles.
        closed: whether its caps carry pressure.
        rings: names of its groups of nodes, "base" and "tip" among them.
        base: those of them that the flange holds from the start.
        cables: their names, in order.
        chambers: names of its gas chambers, in order.
    """

    name: Name
    arrays: Text
    triangles: Count
    closed: bool
    rings: tuple[Text, ...]
    base: tuple[Text, ...]
    cables: tuple[Name, ...]
    chambers: tuple[Text, ...]
    palm: ClassVar[None] = None

    def cable_names(self) -> tuple[str, ...]:
        """Return the names of all cables."""
        return self.cables

    def chamber_names(self) -> tuple[str, ...]:
        """Return the names of all gas chambers."""
        return self.chambers

    def ring_names(self) -> tuple[str, ...]:
        """Return the names of all groups of nodes."""
        return self.rings

    def sides_of(self, _ring: str) -> int:
        """Return how many corners a group has: none."""
        return 0


AnySoftRobot: TypeAlias = SoftRobotTable | GivenBodyTable
"""What stands for the soft robot in a checked scenario."""


@final
@dataclass(frozen=True)
class InFiles:
    """Marks a field that may hold several kinds of tables, of which files give one.

    Args:
        kind: that files give.
    """

    kind: type

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of that kind."""
        return handler(self.kind)
