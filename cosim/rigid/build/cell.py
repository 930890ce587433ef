"""The cell that a robot stands in: whatever stands still around the arm, or is moved by drives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

CELL: Final = "cell"
"""Body that carries the world of the cell; names of its own are behind it and a slash."""


@final
@dataclass(frozen=True)
class CellJoint:
    """A joint of a cell, which a drive moves.

    Args:
        name: of the joint, or of its body if it has none.
        slides: whether it does, or turns.
        limits: smallest and largest place [m] or [rad]; infinite without any.
    """

    name: str
    slides: bool
    limits: tuple[float, float]


@final
@dataclass(frozen=True)
class Cell:
    """A cell, ready to be put around an arm.

    Args:
        path: of its MJCF.
        spec: MuJoCo's specification of it; copied before it is used.
        touched: how many geoms collide.
        has_plane: whether a plane of it collides, which then is the floor.
        joints: that drives move, in the order of the compiled model.
        ignored: options of the file that the scene has otherwise, with their values.
    """

    path: Path
    spec: Any
    touched: int
    has_plane: bool
    joints: tuple[CellJoint, ...]
    ignored: tuple[str, ...]

    @property
    def report(self) -> str:
        """What to say about it."""
        floor = "its plane is the floor" if self.has_plane else "on the scene's floor"
        text = f"{self.path.name}, {self.touched} geoms that can be touched, {floor}"
        if self.joints:
            text = f"{text}; driven: {', '.join(joint.name for joint in self.joints)}"
        return f"{text}; options left out: {', '.join(self.ignored)}" if self.ignored else text
