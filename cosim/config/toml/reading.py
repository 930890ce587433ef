"""Reads TOML files, which may come from anybody, within bounds, and sets values in tables by key path
(`--set`).
"""

import sys
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, Final

from cosim.base.files import read_text
from cosim.config.toml.keys import join, label, shown
from cosim.errors import ScenarioError

_LONGEST_EXAMPLE: Final = 200  # characters
DEEPEST: Final = 24
LONGEST_TEXT: Final = 10_000
LONGEST_LIST: Final = 10_000
LARGEST_INTEGER: Final = 2**63 - 1
"""Largest integer that TOML requires of every reader."""


def read_table(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; a byte order mark is skipped.

    Raises:
        ScenarioError: the file cannot be read, is too large, or is not TOML; `path` is the file's name.
    """
    try:
        return tomllib.loads(read_text(path).replace("\r\n", "\n"))
    except OSError as error:
        raise ScenarioError(str(path), f"cannot be read: {error.strerror}") from error
    except RecursionError:
        raise ScenarioError(str(path), f"is nested too deeply; at most {DEEPEST} levels are read") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(str(path), f"is not TOML: {error}") from error
    except ValueError as error:
        most = sys.get_int_max_str_digits()
        raise ScenarioError(str(path), f"holds a whole number of more than {most} digits") from error


def plain(value: Any, path: str, unread: dict[str, str], depth: int = 0) -> Any:
    """Return a copy of a value in dicts and lists, with None for values that are too large to be read.

    Args:
        value: from TOML or Python, also tuples and arrays.
        path: of the value.
        unread: path -> reason; gets values that are nested too deeply, too long or too large.
        depth: of the value in its table.
    """
    problem = _problem(value, depth)
    if problem is not None:
        unread[path] = problem
        return None
    if isinstance(value, Mapping):
        entries = ((str(key), item) for key, item in value.items())
        return {key: plain(item, join(path, key), unread, depth + 1) for key, item in entries}
    if hasattr(value, "tolist"):
        return plain(value.tolist(), path, unread, depth)
    if isinstance(value, list | tuple):
        items = enumerate(value)
        return [plain(item, join(path, label(item, k + 1)), unread, depth + 1) for k, item in items]
    return value


def _problem(value: Any, depth: int) -> str | None:
    if depth > DEEPEST:
        return f"is nested too deeply; at most {DEEPEST} levels are read"
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"is a text of {len(value)} characters; at most {LONGEST_TEXT} are read"
    if isinstance(value, str) and not value.isascii() and any("\ud800" <= sign <= "\udfff" for sign in value):
        return f"{shown(value)} must be a text of Unicode's characters"
    if isinstance(value, list | tuple) and len(value) > LONGEST_LIST:
        return f"is a list of {len(value)} entries; at most {LONGEST_LIST} are read"
    if isinstance(value, int) and not -LARGEST_INTEGER <= value <= LARGEST_INTEGER:
        return f"is a whole number of {value.bit_length()} bits; at most 63 and a sign are read"
    return None


def parse_assignment(text: str) -> tuple[str, Any]:
    """Return the key path and value of `key=value`; the value is TOML, or else a bare text.

    Raises:
        ScenarioError: there is no "=", or the key path has an empty part.
    """
    path, equals, value = text.partition("=")
    path = path.strip()
    if not equals or not all(path.split(".")):
        raise ScenarioError("", f"'{text}' is not of the form key=value, such as clock.tick_s=0.001")
    return path, _value(value.strip())


def apply_override(table: dict[str, Any], path: str, value: Any) -> None:
    """Set one value in nested tables, in place.

    An entry of a list of tables is addressed by its name or its number, counted from 1:
    `phase.inflate.pressure_Pa` or `phase.2.pressure_Pa`. A table that gets another kind loses its other keys.

    Args:
        table: as TOML gives it; changed in place.
        path: of the key.
        value: of the key.

    Raises:
        ScenarioError: a part of the path is neither a table nor a list of tables, or has an index in
            brackets.
    """
    if "[" in path:
        _refuse_brackets(table, path)
    *parents, last = path.split(".")
    holder: Any = None
    here: Any = table
    for depth, part in enumerate(parents):
        holder, here = here, _enter(here, part, ".".join(parents[:depth]))
    if not isinstance(here, dict):
        kind = "a list; set it as a whole" if isinstance(here, list) else "a single value"
        raise ScenarioError(path, f"cannot be set: {'.'.join(parents)} is {kind}")
    if isinstance(holder, dict) and _other_kind(here, {last: value}):
        here.clear()
    here[last] = value


def _refuse_brackets(table: dict[str, Any], path: str) -> None:
    """Refuse an index in brackets, such as phase[1], if the key is a list; the message has the right path."""
    key, _, rest = path.partition("[")
    place, _, rest = rest.partition("]")
    here: Any = deepcopy(table)  # a table that is not there is entered too
    for depth, part in enumerate(parts := key.split(".")):
        here = _enter(here, part, ".".join(parts[:depth]))
    if not isinstance(here, list) or not here:
        return
    if not all(isinstance(entry, dict) for entry in here):
        such = f", such as {key}={here}" if len(str(here)) <= _LONGEST_EXAMPLE else ""
        raise ScenarioError(path, f"an entry of a list cannot be set alone; set {key} as a whole{such}")
    names = {str(index): entry.get("name", index + 1) for index, entry in enumerate(here)}
    name = place if place in names.values() else names.get(place, next(iter(names.values())))
    problem = f"entries are named, or counted from 1; write {key}.{name}{rest}; there are: "
    raise ScenarioError(path, problem + ", ".join(map(str, names.values())))


def merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with `changes` on top: tables of equal kind are merged by key, other values replaced."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, Mapping) and not _other_kind(old, value):
            merged[key] = merge(old, value)
        else:
            merged[key] = value
    return merged


def _other_kind(table: Mapping[str, Any], changes: Mapping[str, Any]) -> bool:
    """Return whether changes give a table another kind, whose keys may differ."""
    return "kind" in table and "kind" in changes and table["kind"] != changes["kind"]


def _enter(here: Any, part: str, path: str) -> Any:
    if isinstance(here, dict):
        return here.setdefault(part, {})
    if isinstance(here, list) and all(isinstance(entry, dict) for entry in here):
        for entry in here:
            if entry.get("name") == part:
                return entry
        if part.isdecimal() and 1 <= int(part) <= len(here):
            return here[int(part) - 1]
        names = ", ".join(str(entry.get("name", index)) for index, entry in enumerate(here, start=1))
        raise ScenarioError(f"{path}.{part}", f"no such entry; there are: {names or 'none'}")
    raise ScenarioError(f"{path}.{part}", f"cannot be set: {path} is not a table")


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # not TOML, a number of thousands of digits, thousands of brackets
        pass
    try:
        return float(text)
    except ValueError:
        return text
