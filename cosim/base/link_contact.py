"""What a link of an arm touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class LinkContact:
    """A link that touches something.

    Args:
        link: its name.
        other: of an object, of the floor, or of a link.
        depth_m: how far they overlap, of the deepest point.
        movable: whether the other one can move, links not counted.
    """

    link: str
    other: str
    depth_m: float
    movable: bool
