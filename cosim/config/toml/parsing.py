"""Turns tables (nested dicts, as TOML gives them) into frozen dataclasses, strictly.

Every refusal names the path of the key, the value, and what is allowed.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from cosim.config.toml.constraints import LONGEST_NAME, Bounds, Constraint, shown
from cosim.config.toml.magnitudes import magnitude_of
from cosim.config.toml.suggestions import unknown_key_message
from cosim.errors import ScenarioError

Schema = TypeVar("Schema")


def parse(schema: type[Schema], table: Any, path: str = "") -> Schema:
    """Return the dataclass that a table describes.

    Args:
        schema: a frozen dataclass whose annotations carry the constraints.
        table: as TOML gives it.
        path: of the table itself, for messages.

    Raises:
        ScenarioError: no table, an unknown or missing key, a wrong type, or a value out of bounds.
    """
    if not isinstance(table, Mapping):
        raise ScenarioError(path, f"expected a table, got {describe(table)}")
    annotations = _annotations(schema)  # type: ignore[arg-type]
    known = {key_of(entry): entry for entry in fields(schema)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise ScenarioError(join(path, key), unknown_key_message(key, tuple(known)))
    values: dict[str, Any] = {}
    for key, entry in known.items():
        if key in table:
            values[entry.name] = _convert(annotations[entry.name], table[key], join(path, key), key)
        elif entry.default is MISSING and entry.default_factory is MISSING:
            raise ScenarioError(join(path, key), "is missing; it has no default")
    return schema(**values)


def key_of(entry: Field[Any]) -> str:
    """Return the key in the file of a dataclass field."""
    return str(entry.metadata.get("key", entry.name))


def join(path: str, key: str) -> str:
    """Return the path of a key inside a table; a key that would not show is put in quotes, as in TOML."""
    visible = key if key.isprintable() and key and not set(key) & set(" .\"'") else json.dumps(key)
    return f"{path}.{visible}" if path else visible


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
def _annotations(schema: type) -> dict[str, Any]:
    return get_type_hints(schema, include_extras=True)


def _convert(annotation: Any, value: Any, path: str, key: str) -> Any:
    """Return a value as its annotation says; `key` is that of the dataclass, whose unit bounds numbers."""
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *extras = get_args(annotation)
        converted = _convert(inner, value, path, key)
        for constraint in (extra for extra in extras if isinstance(extra, Constraint)):
            message = constraint.violation(converted) or _too_small(constraint, converted, key)
            if message:
                raise ScenarioError(path, message)
        return converted
    if origin in (Union, types.UnionType):  # X | None: TOML has no null, so a value given is an X
        options = [argument for argument in get_args(annotation) if argument is not type(None)]
        return _convert(_fitting(options, value), value, path, key)
    if origin is Literal:
        return _choice(get_args(annotation), value, path)
    if origin is tuple:
        return _sequence(get_args(annotation), value, path, key)
    if origin is Mapping:
        _, inner = get_args(annotation)
        if not isinstance(value, Mapping):
            raise ScenarioError(path, f"expected a table, got {describe(value)}")
        return {name: _convert(inner, item, join(path, name), key) for name, item in value.items()}
    if is_dataclass(annotation):
        return parse(annotation, value, path)  # type: ignore[arg-type]
    return _scalar(annotation, value, path, key)


def _fitting(options: list[Any], value: Any) -> Any:
    """Return which of several annotations a value is for: a list, a table, or the first one."""
    kind = tuple if isinstance(value, list) else Mapping if isinstance(value, Mapping) else None
    return next((option for option in options if kind and get_origin(option) is kind), options[0])


def _choice(choices: tuple[Any, ...], value: Any, path: str) -> Any:
    for choice in choices:
        if value == choice and type(value) is type(choice):
            return choice
    allowed = ", ".join(f"'{choice}'" if isinstance(choice, str) else str(choice) for choice in choices)
    raise ScenarioError(path, f"got {describe(value)}; allowed: {allowed}")


def _sequence(arguments: tuple[Any, ...], value: Any, path: str, key: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise ScenarioError(path, f"expected a list, got {describe(value)}")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        arguments = (arguments[0],) * len(value)
    if len(arguments) != len(value):
        raise ScenarioError(path, f"has {len(value)} entries; must have {len(arguments)}")
    pairs = zip(arguments, value, strict=True)
    return tuple(
        _convert(argument, item, join(path, label(item, index)), key)
        for index, (argument, item) in enumerate(pairs, start=1)
    )


def label(item: Any, index: int) -> str:
    """Return the name of an entry of a list of tables, else (or if it is too long) its place from 1."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name if isinstance(name, str) and 0 < len(name) <= LONGEST_NAME else str(index)


def _too_small(constraint: Constraint, value: Any, key: str) -> str | None:
    """Return what is wrong with a number that must be above 0 and is as good as 0."""
    smallest = magnitude_of(key).smallest
    if isinstance(constraint, Bounds) and constraint.above == 0.0 and value < smallest:
        return f"{value:g} is out of bounds; must be at least {smallest:g}"
    return None


def _scalar(kind: Any, value: Any, path: str, key: str) -> Any:
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ScenarioError(path, f"expected a number, got {describe(value)}")
        number = float(value)
        if not math.isfinite(number):
            raise ScenarioError(path, f"got {value:g}; must be a finite number")
        largest = magnitude_of(key).largest
        if abs(number) > largest:
            raise ScenarioError(
                path, f"{value:g} is out of bounds; must be within {-largest:g} and {largest:g}"
            )
        return number
    expected = {bool: "true or false", int: "a whole number", str: "a text in quotes"}[kind]
    if type(value) is not kind:
        raise ScenarioError(path, f"expected {expected}, got {describe(value)}")
    return value
