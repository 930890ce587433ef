"""The cell that a robot stands in: whatever stands still around the arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final


@final
@dataclass(frozen=True)
class Cell:
    """A cell, ready to be put around an arm.

    Args:
        path: of its MJCF.
        spec: MuJoCo's specification of it; copied before it is used.
        files: that it was read from.
        touched: how many geoms collide.
        has_plane: whether a plane of it collides, which then is the floor.
        ignored: options of the file that the scene has otherwise, with their values.
    """

    path: Path
    spec: Any
    files: tuple[Path, ...]
    touched: int
    has_plane: bool
    ignored: tuple[str, ...]

    @property
    def report(self) -> str:
        """What to say about it."""
        floor = "its plane is the floor" if self.has_plane else "on the scene's floor"
        text = f"{self.path.name}, {self.touched} geoms that can be touched, {floor}"
        return f"{text}; options left out: {', '.join(self.ignored)}" if self.ignored else text
