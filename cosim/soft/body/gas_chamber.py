"""Gas chambers: which film and which caps of a body enclose the gas of each; values per chamber."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar, final

import numpy as np

from cosim.base.frames import IntArray
from cosim.errors import InputError, MeshError
from cosim.soft.elements.gas import SealedGas

Value = TypeVar("Value")


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


def of_each(value: Value | tuple[Value, ...], count: int, what: str) -> tuple[Value, ...]:
    """Return a value for each chamber: the given ones, or the one that all have.

    Args:
        value: of all chambers, or a tuple of one for each.
        count: of the chambers.
        what: it is, for the message.

    Raises:
        InputError: there are more or fewer values than chambers.
    """
    if not isinstance(value, tuple):
        return (value,) * count
    if len(value) != count:
        raise InputError(
            f"{what}: {len(value)} values for {count} chambers; give one for each, or one number"
        )
    return value


def pressure_between(
    begin: float | tuple[float, ...], end: float | tuple[float, ...], load_factor: float
) -> float | tuple[float, ...]:
    """Return gauge pressures [Pa] at a load factor, of all chambers or of each."""
    if not isinstance(begin, tuple) and not isinstance(end, tuple):
        return (1.0 - load_factor) * begin + load_factor * end
    count = len(begin) if isinstance(begin, tuple) else len(end) if isinstance(end, tuple) else 1
    pairs = zip(of_each(begin, count, "pressure"), of_each(end, count, "pressure"), strict=True)
    return tuple((1.0 - load_factor) * first + load_factor * last for first, last in pairs)


Gases = SealedGas | None | tuple[SealedGas | None, ...]
"""A sealed gas, the same amount in every chamber; or for each chamber one, or None for a given pressure."""


def gas_between(begin: Gases, end: Gases, load_factor: float) -> Gases:
    """Return sealed gases at a load factor; where either end has none, what is at the end."""
    if not isinstance(begin, tuple) and not isinstance(end, tuple):
        return end if begin is None or end is None else begin.towards(end, load_factor)
    count = len(begin) if isinstance(begin, tuple) else len(end) if isinstance(end, tuple) else 1
    pairs = zip(of_each(begin, count, "gas"), of_each(end, count, "gas"), strict=True)
    return tuple(
        last if first is None or last is None else first.towards(last, load_factor) for first, last in pairs
    )
