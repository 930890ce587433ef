"""Held objects with their times, from a summary."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, Mask


@final
@dataclass(frozen=True)
class HeldPart:
    """An object while a soft robot holds it.

    Args:
        name: of the object.
        mass_kg: of the object.
        since_s: start of the hold.
        until_s: its end; infinite if the object is held at the end of the run.
    """

    name: str
    mass_kg: float
    since_s: float
    until_s: float

    def at(self, time_s: Array) -> Mask:
        """Return whether it is held at times (n,) [s]."""
        return np.asarray((time_s >= self.since_s) & (time_s < self.until_s))


def held_parts(summary: Mapping[str, Any]) -> list[HeldPart]:
    """Return the held objects of a summary, one for each hold."""
    return [
        HeldPart(
            row["name"],
            row["mass_kg"],
            span["since_s"],
            math.inf if span["until_s"] is None else span["until_s"],
        )
        for row in summary.get("objects", ())
        for span in row["held"]
    ]
