"""Keys of files and their values: paths, constraints, magnitudes by unit, suggestions for unknown ones.

Paths of keys and words for values, as messages show them.

Types of a scenario's values, with their constraints.

`Annotated[float, Interval(gt=0.0)]` reads as "a number above 0"; bounds of numbers and lengths are those of
the package annotated_types, the rest is here.

How large a number of each unit may be: beyond, no arm, film or scene is meant, and floating point ends.

Whatever a key's own bounds are, its number lies within those of its unit. A number that must be above 0 is
at least the smallest one, so that nothing is divided by what is as good as zero.

Words for unknown keys: the nearest known ones, and units that do not fit.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import Field, dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Final, final

from annotated_types import Interval, Len

LONGEST_SHOWN: Final = 60
LONGEST_NAME: Final = 64
LONGEST_KEY: Final = 100


def key_of(entry: Field[Any]) -> str:
    """Return the key in the file of a dataclass field."""
    return str(entry.metadata.get("alias", entry.name))


def join(path: str, key: str) -> str:
    """Return the path of a key inside a table; a key that would not show is put in quotes, as in TOML."""
    cut = key if len(key) <= LONGEST_KEY else f"{key[:LONGEST_KEY]}..."
    visible = cut if cut.isprintable() and cut and not set(key) & set(" .\"'") else json.dumps(cut)
    return f"{path}.{visible}" if path else visible


def label(item: Any, index: int) -> str:
    """Return the name of an entry of a list of tables, else (or if it is too long) its place from 1."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name if isinstance(name, str) and 0 < len(name) <= LONGEST_NAME else str(index)


def shown(value: Any) -> str:
    """Return a value as messages show it: texts in quotes, control characters escaped, long ones cut."""
    quoted = repr(value)
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


LEAST_DIRECTION: Final = 1e-9


@final
@dataclass(frozen=True)
class Rule:
    """What a value must satisfy beyond its type, as pydantic applies it.

    Args:
        problem: returns what is wrong with a value, or None.
    """

    problem: Callable[[Any], str | None]

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of the type, with the rule after it."""
        from pydantic_core import PydanticCustomError, core_schema  # here: engines import the schema as well

        def checked(value: Any) -> Any:
            if problem := self.problem(value):
                raise PydanticCustomError("rule", "{problem}", {"problem": problem})
            return value

        return core_schema.no_info_after_validator_function(checked, handler(source))


@final
@dataclass(frozen=True)
class Pattern:
    """A text that a regular expression matches; `meaning` says in words what is asked."""

    expression: str
    meaning: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of a text with this pattern."""
        return {**handler(source), "pattern": self.expression, "metadata": {"meaning": self.meaning}}


@final
class OrByName:
    """A list that a file may also give as a table by names; `resolve` turns it into a list."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Return the schema of the list, or of a table with the same entries."""
        from pydantic_core import core_schema  # here: engines import the schema as well

        listed = handler(source)
        named = core_schema.dict_schema(core_schema.str_schema(), listed["items_schema"][0])
        return core_schema.union_schema([listed, named])


def _without_direction(vector: Sequence[float]) -> str | None:
    if sum(component * component for component in vector) <= LEAST_DIRECTION**2:
        return f"{list(vector)} has no direction; must not be zero"
    return None


def _not_increasing(values: Sequence[float]) -> str | None:
    grows = all(first < second for first, second in pairwise(values))
    return None if grows else f"{list(values)} must increase from entry to entry"


Positive = Annotated[float, Interval(gt=0.0)]
NonNegative = Annotated[float, Interval(ge=0.0)]
Fraction = Annotated[float, Interval(gt=0.0, lt=1.0)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Pressure = Annotated[float, Interval(ge=-1e5)]
"""Gauge pressure: not below vacuum."""

Count = Annotated[int, Interval(ge=1, le=1_000_000)]
Vector3 = tuple[float, float, float]
Direction = Annotated[tuple[float, float, float], Rule(_without_direction)]
Quaternion = Annotated[tuple[float, float, float, float], Rule(_without_direction)]
Increasing = Rule(_not_increasing)
Colour = tuple[Share, Share, Share, Share]
Name = Annotated[
    str,
    Len(max_length=LONGEST_NAME),
    Pattern("^[A-Za-z][A-Za-z0-9_-]*$", "a letter followed by letters, digits, '_' or '-'"),
]
Text = Annotated[
    str,
    Pattern(
        r"^[^\u0000-\u0008\u000b-\u001f\u007f-\u009f]*[^\s\u0000-\u0008\u000b-\u001f\u007f-\u009f]"
        r"[^\u0000-\u0008\u000b-\u001f\u007f-\u009f]*$",
        "a text that is not empty, without control characters but tabs and line breaks",
    ),
]


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
    "m_s": Magnitude(1e9, 1e-6),
    "rad_s": Magnitude(1e9, 1e-6),
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
    "m_s": "m/s", "rad_s": "rad/s",
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


_FOREIGN: Final = (
    "g_cm3", "hPa", "kPa", "MPa", "GPa", "mbar", "bar", "psi", "mm", "cm", "um", "mN", "kN", "ms", "us",
    "min", "deg", "degrees", "g",
)  # fmt: skip
"""Units that other programs use. The message names the key's own unit."""
_UNITS: Final = sorted((*_BY_UNIT, *_FOREIGN), key=len, reverse=True)


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
        right = f"{likely[0]} (in {unit_text(likely_unit)}; units are not converted)"
        return f"unknown key; {given}: write {right}"
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


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the names that a name, group or pattern represents, in their order."""
    return [name for name in names if name.startswith(f"{pattern}/") or fnmatchcase(name, pattern)]


def split_unit(key: str) -> tuple[str, str]:
    """Return a key's stem and its unit ("" if it has none)."""
    for unit in _UNITS:
        if key.lower().endswith("_" + unit.lower()):
            return key[: -len(unit) - 1], key[-len(unit) :]
    return key, ""
