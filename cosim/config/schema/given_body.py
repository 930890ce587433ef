"""A soft body given from Python as arrays: the names that a scenario may use of it, and its entry in the
written scenario.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeAlias, final

from pydantic import Discriminator, Tag

from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.quantities import Count, Name, Text
from cosim.config.toml.tables import Table


@final
@dataclass(frozen=True)
class GivenBodyTable(Table):
    """A soft body given as arrays. The table records its names; its shape and film are in no file.

    Args:
        name: of the body.
        arrays: digest of its arrays: equal bodies have equal digests.
        triangles: number of film triangles.
        closed: whether its caps carry pressure.
        rings: names of its groups of nodes, "base" and "tip" among them.
        base: groups that the flange holds from the start.
        cables: names of its cables, in order.
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
        """Return 0: a group of nodes has no corners."""
        return 0


def _kind_of_body(value: Any) -> str:
    return "given as arrays" if isinstance(value, Mapping) and "arrays" in value else "of a file"


AnySoftRobot: TypeAlias = Annotated[
    Annotated[SoftRobotTable, Tag("of a file")] | Annotated[GivenBodyTable, Tag("given as arrays")],
    Discriminator(_kind_of_body),
]
"""The soft robot of a checked scenario: the table of its file, or a body given as arrays."""
