"""Gas chambers: which film and which caps of a body enclose the gas of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import IntArray
from cosim.errors import MeshError


@final
@dataclass(frozen=True)
class GasChamber:
    """The part of a body that encloses one gas.

    Args:
        name: such as "copy_2".
        triangles: (t,) places in the body's film triangles.
        caps: places in the body's caps.
    """

    name: str
    triangles: IntArray
    caps: tuple[int, ...]

    def shifted(self, name: str, triangles: int, caps: int) -> GasChamber:
        """Return the same chamber under another name, where this many triangles and caps come before it."""
        return GasChamber(name, self.triangles + triangles, tuple(cap + caps for cap in self.caps))


def check_chambers(chambers: Sequence[GasChamber], triangles: int, caps: int) -> None:
    """Check that every triangle and cap belongs to exactly one chamber, and that names differ.

    Args:
        chambers: of a body; none is fine.
        triangles: how many it has.
        caps: how many it has.

    Raises:
        MeshError: they do not.
    """
    if not chambers:
        return
    names = [chamber.name for chamber in chambers]
    if len(set(names)) < len(names):
        raise MeshError(f"chambers are called {', '.join(names)}; names must differ")
    for what, count, places in (
        ("triangle", triangles, np.concatenate([chamber.triangles for chamber in chambers])),
        ("cap", caps, np.array([cap for chamber in chambers for cap in chamber.caps], dtype=np.int64)),
    ):
        used = np.zeros(count, dtype=np.int64)
        if places.size and (places.min() < 0 or places.max() >= count):
            raise MeshError(f"a chamber has {what} {int(places.max())}; there are {count}")
        np.add.at(used, places, 1)
        if (used != 1).any():
            wrong = int(np.flatnonzero(used != 1)[0])
            raise MeshError(f"{what} {wrong} belongs to {used[wrong]} chambers; it must belong to one")
