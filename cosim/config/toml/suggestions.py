"""Words for unknown keys: the nearest known ones, and units that do not fit."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches

from cosim.config.toml.key_paths import LONGEST_KEY, LONGEST_NAME, shown

_UNITS = (
    "kg_s_Pa",
    "m_s2",
    "kg_m3",
    "g_cm3",
    "per_s",
    "Pa",
    "hPa",
    "kPa",
    "MPa",
    "GPa",
    "mbar",
    "bar",
    "psi",
    "m",
    "mm",
    "cm",
    "um",
    "N",
    "mN",
    "kN",
    "s",
    "ms",
    "us",
    "min",
    "rad",
    "deg",
    "degrees",
    "kg",
    "g",
    "K",
)


def unknown_key_message(key: str, known: tuple[str, ...]) -> str:
    """Return what to say about a key that does not exist among the known ones."""
    if len(key) > LONGEST_KEY:
        return f"has {len(key)} characters; keys have at most {LONGEST_KEY}"
    likely = likely_keys(key, known)
    if not likely:
        return f"unknown key; known are: {', '.join(sorted(known))}"
    (stem, unit), (likely_stem, likely_unit) = split_unit(key), split_unit(likely[0])
    if likely_unit and likely_stem.lower() == stem.lower():
        given = f"'{unit}' is not the unit of this key" if unit else "the unit is part of the key"
        return f"unknown key; {given}: write {likely[0]} (in {likely_unit}; units are not converted)"
    return f"unknown key; did you mean {' or '.join(likely)}?"


def likely_keys(key: str, known: Sequence[str]) -> list[str]:
    """Return which of the known keys may be meant by one that does not exist: by its stem, or its letters."""
    if len(key) > LONGEST_KEY:
        return []
    stem = split_unit(key)[0].lower()
    same = [other for other in known if split_unit(other)[1] and split_unit(other)[0].lower() == stem]
    return same[:1] or get_close_matches(key, known, n=3, cutoff=0.6)


def unknown_name_message(kind: str, name: str, known: tuple[str, ...]) -> str:
    """Return what to say about a name that does not exist among the known ones."""
    close = get_close_matches(name, known, n=1, cutoff=0.6) if len(name) <= LONGEST_NAME else []
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"no {kind} {shown(name)}{hint}. There are: {listing(known)}".replace("?.", "?")


def listing(names: Sequence[str]) -> str:
    """Return names in one line, the middle of many left out."""
    return ", ".join(names if len(names) <= 12 else (*names[:6], "...", *names[-3:])) or "none"


def split_unit(key: str) -> tuple[str, str]:
    """Return a key's stem and its unit ("" if it has none)."""
    for unit in _UNITS:
        if key.lower().endswith("_" + unit.lower()):
            return key[: -len(unit) - 1], key[-len(unit) :]
    return key, ""
