"""Changes to a scenario's tables by key path, as `--set key=value` gives them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from cosim.config.toml.faults import UNKNOWN, NotKnown
from cosim.config.toml.reading import only_readable
from cosim.errors import ScenarioError


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

    Lists of tables are entered by the entry's name or by its place, counted from 1:
    `phase.inflate.pressure_Pa` or `phase.2.pressure_Pa`. A table that gets another kind loses its other keys.

    Raises:
        ScenarioError: the path enters something that is neither a table nor a list of tables.
    """
    *parents, last = path.split(".")
    holder: Any = None
    here: Any = table
    for depth, part in enumerate(parents):
        holder, here = here, _enter(here, part, ".".join(parents[:depth]))
    if here is UNKNOWN:
        raise NotKnown
    if not isinstance(here, dict):
        kind = "a list; set it as a whole" if isinstance(here, list) else "a single value"
        raise ScenarioError(path, f"cannot be set: {'.'.join(parents)} is {kind}")
    if isinstance(holder, dict) and _other_kind(here, {last: value}):
        here.clear()
    here[last] = only_readable(value)


def merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with `changes` on top; tables of one kind merge key by key, all else is replaced."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, Mapping) and not _other_kind(old, value):
            merged[key] = merge(old, value)
        else:
            merged[key] = value
    return merged


def _other_kind(table: Mapping[str, Any], changes: Mapping[str, Any]) -> bool:
    """Return whether a table gets another kind than the one it says, whose keys may be others."""
    return "kind" in table and "kind" in changes and table["kind"] != changes["kind"]


def _enter(here: Any, part: str, path: str) -> Any:
    if here is UNKNOWN:
        raise NotKnown
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
