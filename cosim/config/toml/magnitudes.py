"""How large a number of each unit may be: beyond, no arm, film or scene is meant, and floating point ends.

Whatever a key's own bounds are, its number lies within those of its unit. A number that must be above 0 is
at least the smallest one, so that nothing is divided by what is as good as zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final, final


@final
@dataclass(frozen=True)
class Magnitude:
    """Bounds of a number, whatever its sign.

    Args:
        largest: magnitude.
        smallest: magnitude of a number that must be above 0.
    """

    largest: float
    smallest: float


_ANY: Final = Magnitude(1e12, 1e-12)
_BY_UNIT: Final = {
    "m": Magnitude(100.0, 1e-9),
    "s": Magnitude(1e9, 1e-6),
    "rad": Magnitude(1e4, 1e-9),
    "kg": Magnitude(1e6, 1e-9),
    "K": Magnitude(1e5, 1.0),
    "Hz": Magnitude(1e4, 1e-6),
    "N": Magnitude(1e7, 1e-15),
    "Pa": Magnitude(1e13, 1e-3),
    "Nm": Magnitude(1e7, 1e-12),
    "Nms": Magnitude(1e7, 1e-12),
    "Nm2": Magnitude(1e7, 1e-15),
    "Nm2s": Magnitude(1e7, 1e-15),
    "per_s": Magnitude(1e9, 1e-6),
    "m_s2": Magnitude(1e4, 1e-6),
    "N_m": Magnitude(1e12, 1e-9),
    "Ns_m": Magnitude(1e9, 1e-12),
    "N_m3": Magnitude(1e15, 1e-3),
    "kg_m3": Magnitude(1e6, 1e-6),
    "kg_s": Magnitude(1e3, 1e-15),
    "kg_s_Pa": Magnitude(1.0, 1e-20),
    "m3": _ANY,
    "W": _ANY,
}
_TEXTS: Final = {
    "Nm": "N m", "Nms": "N m s", "Nm2": "N m^2", "Nm2s": "N m^2 s", "per_s": "1/s", "m_s2": "m/s^2",
    "m3": "m^3",
    "N_m": "N/m", "Ns_m": "N s/m", "N_m3": "N/m^3", "kg_m3": "kg/m^3", "kg_s": "kg/s", "kg_s_Pa": "kg/(s Pa)",
}  # fmt: skip


@cache
def magnitude_of(key: str) -> Magnitude:
    """Return the bounds of a key's numbers: those of the longest unit that it ends in."""
    return _BY_UNIT.get(unit_of(key), _ANY)


@cache
def unit_of(key: str) -> str:
    """Return the longest unit that a key ends in, as keys write it; empty for a key without one."""
    words = key.split("_")
    endings = ("_".join(words[k:]) for k in range(1, len(words)))
    return next((unit for unit in endings if unit in _BY_UNIT), "")


def unit_text(unit: str) -> str:
    """Return a unit of `unit_of` as people write it, such as N/m^3."""
    return _TEXTS.get(unit, unit)
