"""Seeded mutations of TOML tables: wrong types, signs, sizes, names and shapes, and broken texts."""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from random import Random
from typing import Any, NamedTuple, TypeAlias

Place: TypeAlias = tuple[str | int, ...]
"""Keys and places from the top of nested tables and lists down to a value."""
Source: TypeAlias = Mapping[str, Any]
"""Tables as they were before any mutation."""
Change: TypeAlias = Callable[[dict[str, Any], Place, Random, Source], str]
"""Changes tables at a place, and returns in words how."""

_NUMBERS = (
    0, -1, 1, 2, 3, 7, 64, 201, 1979, 10**6, -(10**6), 10**12, 2**63 - 1, 2**63, 10**400, -(10**400), 0.0,
    -0.0, 0.5, -0.5, 1.0, 1e-300, 5e-324, 1e-17, 1e-6, 1e3, 1e6, 1e16, 1e150, 1e200, 1e300, -1e300, math.nan,
    math.inf, -math.inf,
)  # fmt: skip
_TEXTS = (
    "", " ", "x", "none", "nan", "true", "hexagon_arm", "gripper_finger", "ur5e", "panda", "auto",
    "section", "rigid", "refined", "quasistatic", "unit_1.hole", "unit_99.outer", "*", "copy_*/tip",
    "[", "[!a", "a" * 300, "\u00e4\u00f6", "\U0001f916", "\u202e", "\x1b[2J", "a\x00b", "a\nb", "../../x",
    "/etc/passwd", "~/x.toml", "loop.toml", "spool.obj", "m.stl", "x.y.z", "'\"\\",
)  # fmt: skip
_OTHERS: tuple[Any, ...] = (
    True, False, [], {}, [[]], [{}], {"": 1}, {"name": 5}, [True], [1.0], [0.0, 0.0, 0.0], [math.nan] * 3,
    [1.0, 2.0], [0.0] * 50, ["x"], [""], {"file": 5}, {"file": "hexagon_arm"}, {"x": {"y": {"z": 1}}},
    datetime.date(2020, 1, 1),
)  # fmt: skip


class Mutation(NamedTuple):
    """A change of nested tables.

    Args:
        place: of what changes, in the tables as they were.
        change: what is done.
        seed: of its random choices.
    """

    place: Place
    change: Change
    seed: int


def mutations_of(table: Mapping[str, Any], rng: Random) -> list[Mutation]:
    """Return one to three mutations, none of them within what another one changes.

    Args:
        table: as TOML gives it.
        rng: decides.
    """
    places = list(_places(table))
    found: list[Mutation] = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        mutation = Mutation(rng.choice(places), rng.choice(_MUTATIONS), rng.getrandbits(32))
        if not any(_nested(mutation.place, other.place) for other in found):
            found.append(mutation)
    return found


def mutated(table: Mapping[str, Any], mutations: Sequence[Mutation]) -> tuple[dict[str, Any], list[str]]:
    """Return a copy of nested tables with some mutations, and what they are; the last places come first.

    One whose place another one has taken away, such as by a second key of its name, is left out.
    """
    changed: dict[str, Any] = deepcopy(dict(table))
    done = []
    for mutation in sorted(mutations, key=lambda mutation: _ordered(mutation.place), reverse=True):
        if _is_there(changed, mutation.place):
            done.append(mutation.change(changed, mutation.place, Random(mutation.seed), table))
    return changed, done


def _ordered(place: Place) -> tuple[str, ...]:
    return tuple(f"{key:09d}" if isinstance(key, int) else key for key in place)


def _is_there(table: Source, place: Place) -> bool:
    try:
        _holder(table, place)[place[-1]]
    except (KeyError, IndexError, TypeError):
        return False
    return True


def _nested(first: Place, second: Place) -> bool:
    return first[: len(second)] == second or second[: len(first)] == first


def broken(text: str, rng: Random) -> tuple[str, str]:
    """Return a text with some characters lost, doubled, put in or cut off, and what was done."""
    at, length = rng.randrange(len(text)), rng.randrange(1, 40)
    lost, kept = text[at : at + length], text[at + length :]
    what = rng.choice(("lost", "doubled", "cut", "put in", "mark"))
    match what:
        case "lost":
            return text[:at] + kept, f"{length} characters lost at {at}"
        case "doubled":
            return text[:at] + lost + lost + kept, f"{length} characters doubled at {at}"
        case "cut":
            return text[:at], f"cut off at {at}"
        case "mark":
            return "\ufeff" + text, "byte order mark"
    put_in = rng.choice(
        ("[", "]", '"', "'''", "=", "\x00", "{", "#", "[[", "e999", ".", "\r", "9" * 5000, "[" * 1200)
    )
    return text[:at] + put_in + text[at:], f"{put_in[:9]!r} put in at {at}"


def toml_text(value: Any) -> str:
    """Return nested tables as TOML, every value of the top on one line."""
    if isinstance(value, Mapping):
        return "".join(f"{_quoted(str(key))} = {_inline(item)}\n" for key, item in value.items())
    raise TypeError(f"the top of a TOML file is a table, not {type(value).__name__}")


def _places(value: Any, here: Place = ()) -> Any:
    """Yield the places of all values below one."""
    entries = (
        value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    )
    for key, item in entries:
        yield (*here, key)
        yield from _places(item, (*here, key))


def _holder(table: Source, place: Place) -> Any:
    here: Any = table
    for key in place[:-1]:
        here = here[key]
    return here


def _set(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    value = deepcopy(rng.choice(rng.choice((_NUMBERS, _TEXTS, _OTHERS))))
    _holder(table, place)[place[-1]] = value
    return f"set {place} to {value!r:.60}"


def _scale(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    """Multiply a number; a text or a list is repeated."""
    holder, factor = (
        _holder(table, place),
        10.0 ** rng.choice((-300, -100, -12, -6, -3, -1, 1, 2, 3, 4, 6, 12, 100, 300)),
    )
    value = holder[place[-1]]
    if isinstance(value, bool) or not isinstance(value, int | float):
        if isinstance(value, str | list):
            holder[place[-1]] = value * rng.choice((2, 3, 50))
        return f"repeat {place}"
    holder[place[-1]] = _product(value, factor) * rng.choice((1.0, -1.0))
    return f"multiply {place} by {factor:g}"


def _product(value: float, factor: float) -> float:
    """Return a product; infinite for an integer that is larger than any float."""
    try:
        return value * factor
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _delete(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    del _holder(table, place)[place[-1]]
    return f"delete {place}"


def _rename(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    holder = _holder(table, place)
    if not isinstance(holder, dict):
        return _set(table, place, rng, source)
    old = str(place[-1])
    new = rng.choice(("", " ", old.upper(), old[:-1], old + "_m", old.rpartition("_")[0], rng.choice(_TEXTS)))
    items = [(new if key == old else key, item) for key, item in holder.items()]
    holder.clear()
    holder.update(items)
    return f"rename {place} to {new!r:.40}"


def _swap(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    """Put the value of one place at another one, both copied."""
    other = rng.choice(list(_places(source)))
    value = deepcopy(_holder(source, other)[other[-1]])
    _holder(table, place)[place[-1]] = value
    return f"put {other} at {place}"


def _duplicate(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    """Double an entry of a list; a key gets a second one beside it."""
    holder = _holder(table, place)
    if isinstance(holder, list):
        holder.insert(rng.randrange(len(holder) + 1), deepcopy(holder[int(place[-1])]))
    else:
        holder[rng.choice(("file", "name", "extra", "refine", "units", f"{place[-1]}2"))] = deepcopy(
            holder[place[-1]]
        )
    return f"duplicate {place}"


def _nest(table: dict[str, Any], place: Place, rng: Random, source: Source) -> str:
    holder, depth = _holder(table, place), rng.choice((1, 2, 30, 90))
    wrap: Callable[[Any], Any] = rng.choice((lambda inner: [inner], lambda inner: {"x": inner}))
    value = holder[place[-1]]
    for _ in range(depth):
        value = wrap(value)
    holder[place[-1]] = value
    return f"nest {place} {depth} deep"


_MUTATIONS: tuple[Change, ...] = (
    _set, _set, _set, _set, _scale, _scale, _scale, _delete, _rename, _swap, _swap, _duplicate, _nest,
)  # fmt: skip


def _quoted(text: str) -> str:
    plain = json.dumps(text, ensure_ascii=False)
    return "".join(f"\\u{ord(c):04x}" if ord(c) == 0x7F or 0x80 <= ord(c) < 0xA0 else c for c in plain)


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return hex(value) if value >= 10**100 else "-1" + "0" * 400 if value < -(10**100) else str(value)
    if isinstance(value, float | datetime.date):
        return str(value)
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_quoted(str(key))} = {_inline(item)}" for key, item in value.items()) + "}"
    return "[" + ", ".join(map(_inline, value)) + "]"
