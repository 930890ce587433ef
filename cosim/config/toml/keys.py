"""Words for messages: paths of keys, units, values, and suggestions for unknown keys and names."""

import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import Field
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cache
from importlib import import_module
from typing import Any, Final

LONGEST_SHOWN: Final = 60
LONGEST_NAME: Final = 64
LONGEST_KEY: Final = 100
_MOVED: Final = (
    "Positive",
    "NonNegative",
    "Fraction",
    "Pressure",
    "Count",
    "Vector3",
    "Direction",
    "Name",
    "Text",
)
_UNITS: Final = {
    **{unit: unit for unit in ("m", "s", "rad", "kg", "K", "Hz", "N", "Pa", "W")},
    "Nm": "N m", "Nms": "N m s", "Nm2": "N m^2", "Nm2s": "N m^2 s", "per_s": "1/s", "m_s2": "m/s^2",
    "m_s": "m/s", "rad_s": "rad/s",
    "m3": "m^3",
    "N_m": "N/m", "Ns_m": "N s/m", "N_m3": "N/m^3", "kg_m3": "kg/m^3", "kg_s": "kg/s", "kg_s_Pa": "kg/(s Pa)",
}  # fmt: skip
"""Unit as keys write it -> unit as people write it."""
_FOREIGN: Final = (
    "g_cm3", "hPa", "kPa", "MPa", "GPa", "mbar", "bar", "psi", "mm", "cm", "um", "mN", "kN", "ms", "us",
    "min", "deg", "degrees", "g",
)  # fmt: skip
"""Units of other programs, recognised in unknown keys so that the message names the key's unit."""
_ENDINGS: Final = sorted((*_UNITS, *_FOREIGN), key=len, reverse=True)


def key_of(entry: Field[Any]) -> str:
    """Return the key in the file of a dataclass field."""
    return str(entry.metadata.get("alias", entry.name))


def join(path: str, key: str) -> str:
    """Return the path of a key in a table; a key with spaces, dots or control characters is quoted."""
    cut = key if len(key) <= LONGEST_KEY else f"{key[:LONGEST_KEY]}..."
    visible = cut if cut.isprintable() and cut and not set(key) & set(" .\"'") else json.dumps(cut)
    return f"{path}.{visible}" if path else visible


def label(item: Any, index: int) -> str:
    """Return the name of an entry of a list of tables; its number from 1 if it has none or a too long one."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name if isinstance(name, str) and 0 < len(name) <= LONGEST_NAME else str(index)


def shown(value: Any) -> str:
    """Return a value as messages show it: texts in quotes, control characters escaped, long values cut."""
    try:
        quoted = repr(value)
    except ValueError:  # a whole number of thousands of digits
        return "..."
    return quoted if len(quoted) <= LONGEST_SHOWN else f"{quoted[: LONGEST_SHOWN - 3]}..."


def describe(value: Any) -> str:
    """Return a value with its kind, for messages."""
    kinds: tuple[tuple[type, str], ...] = (
        (bool, "the truth value"),
        (int, "the whole number"),
        (float, "the number"),
        (str, "the text"),
        (list, "the list"),
        (Mapping, "a table"),
    )
    kind = next((name for kind, name in kinds if isinstance(value, kind)), f"a {type(value).__name__}")
    if isinstance(value, Mapping):
        return kind
    return f"{kind} {str(value).lower() if isinstance(value, bool) else shown(value)}"


@cache
def unit_of(key: str) -> str:
    """Return the longest unit that a key ends in, as keys write it; empty for a key without one."""
    words = key.split("_")
    endings = ("_".join(words[k:]) for k in range(1, len(words)))
    return next((unit for unit in endings if unit in _UNITS), "")


def unit_text(unit: str) -> str:
    """Return a unit of `unit_of` as people write it, such as N/m^3."""
    return _UNITS.get(unit, unit)


def unknown_key_message(key: str, known: tuple[str, ...]) -> str:
    """Return the message for an unknown key.

    Args:
        key: the unknown key.
        known: keys of the table.
    """
    if len(key) > LONGEST_KEY:
        return f"has {len(key)} characters; keys have at most {LONGEST_KEY}"
    likely = likely_keys(key, known)
    if not likely:
        return f"unknown key; known are: {', '.join(sorted(known))}"
    (stem, unit), (likely_stem, likely_unit) = split_unit(key), split_unit(likely[0])
    if likely_unit and likely_stem.lower() == stem.lower():
        given = f"'{unit}' is not the unit of this key" if unit else "the unit is part of the key"
        right = f"{likely[0]} (in {unit_text(likely_unit)}; units are not converted)"
        return f"unknown key; {given}: write {right}"
    return f"unknown key; did you mean {' or '.join(likely)}?"


def likely_keys(key: str, known: Sequence[str]) -> list[str]:
    """Return the known keys that an unknown one resembles, by its name without unit or by its letters."""
    if len(key) > LONGEST_KEY:
        return []
    stem = split_unit(key)[0].lower()
    same = [other for other in known if split_unit(other)[1] and split_unit(other)[0].lower() == stem]
    return same[:1] or get_close_matches(key, known, n=3, cutoff=0.6)


def unknown_name_message(kind: str, name: str, known: tuple[str, ...]) -> str:
    """Return the message for an unknown name.

    Args:
        kind: of the named thing, such as "cable".
        name: the unknown name.
        known: names that exist.
    """
    close = get_close_matches(name, known, n=1, cutoff=0.6) if len(name) <= LONGEST_NAME else []
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"no {kind} {shown(name)}{hint}. There are: {listing(known)}".replace("?.", "?")


def listing(names: Sequence[str]) -> str:
    """Return names in one line; of more than 12 the first six and the last three."""
    return ", ".join(names if len(names) <= 12 else (*names[:6], "...", *names[-3:])) or "none"


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the names that match a name, group or pattern, in their order."""
    return [name for name in names if name.startswith(f"{pattern}/") or fnmatchcase(name, pattern)]


def split_unit(key: str) -> tuple[str, str]:
    """Return a key's stem and its unit ("" if it has none)."""
    for unit in _ENDINGS:
        if key.lower().endswith("_" + unit.lower()):
            return key[: -len(unit) - 1], key[-len(unit) :]
    return key, ""


def __getattr__(name: str) -> Any:
    """Return a type of values that moved to `cosim.config.toml.quantities`, with a warning."""
    if name not in _MOVED:
        raise AttributeError(f"module {__name__} has no attribute {name!r}")
    new = "cosim.config.toml.quantities"
    warnings.warn(
        f"import {name} from {new}; {__name__} will not have it in the next release",
        DeprecationWarning,
        stacklevel=2,
    )
    return getattr(import_module(new), name)
