"""Turns tables (nested dicts, as TOML gives them) into frozen dataclasses, strictly.

Every refusal names the path of the key, the value, and what is allowed.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from cosim.errors import ScenarioError
from cosim.scenario.constraints import Constraint
from cosim.scenario.suggestions import unknown_key_message

Schema = TypeVar("Schema")


def parse(schema: type[Schema], table: Mapping[str, Any], path: str = "") -> Schema:
    """Return the dataclass that a table describes.

    Args:
        schema: a frozen dataclass whose annotations carry the constraints.
        table: as TOML gives it.
        path: of the table itself, for messages.

    Raises:
        ScenarioError: an unknown or missing key, a wrong type, or a value out of bounds.
    """
    annotations = _annotations(schema)  # type: ignore[arg-type]
    known = {key_of(entry): entry for entry in fields(schema)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise ScenarioError(join(path, key), unknown_key_message(key, tuple(known)))
    values: dict[str, Any] = {}
    for key, entry in known.items():
        if key in table:
            values[entry.name] = _convert(annotations[entry.name], table[key], join(path, key))
        elif entry.default is MISSING and entry.default_factory is MISSING:
            raise ScenarioError(join(path, key), "is missing; it has no default")
    return schema(**values)


def key_of(entry: Field[Any]) -> str:
    """Return the key in the file of a dataclass field."""
    return str(entry.metadata.get("key", entry.name))


def join(path: str, key: str) -> str:
    """Return the path of a key inside a table."""
    return f"{path}.{key}" if path else key


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
    shown = str(value).lower() if isinstance(value, bool) else repr(value)
    return f"{kind} {shown if len(shown) <= 60 else shown[:57] + '...'}"


@cache
def _annotations(schema: type) -> dict[str, Any]:
    return get_type_hints(schema, include_extras=True)


def _convert(annotation: Any, value: Any, path: str) -> Any:
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *extras = get_args(annotation)
        converted = _convert(inner, value, path)
        for constraint in extras:
            message = constraint.violation(converted) if isinstance(constraint, Constraint) else None
            if message:
                raise ScenarioError(path, message)
        return converted
    if origin in (Union, types.UnionType):  # X | None: TOML has no null, so a value given is an X
        options = [argument for argument in get_args(annotation) if argument is not type(None)]
        return _convert(_fitting(options, value), value, path)
    if origin is Literal:
        return _choice(get_args(annotation), value, path)
    if origin is tuple:
        return _sequence(get_args(annotation), value, path)
    if origin is Mapping:
        _, inner = get_args(annotation)
        if not isinstance(value, Mapping):
            raise ScenarioError(path, f"expected a table, got {describe(value)}")
        return {key: _convert(inner, item, join(path, key)) for key, item in value.items()}
    if is_dataclass(annotation):
        if not isinstance(value, Mapping):
            raise ScenarioError(path, f"expected a table, got {describe(value)}")
        return parse(annotation, value, path)  # type: ignore[arg-type]
    return _scalar(annotation, value, path)


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


def _sequence(arguments: tuple[Any, ...], value: Any, path: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise ScenarioError(path, f"expected a list, got {describe(value)}")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        arguments = (arguments[0],) * len(value)
    if len(arguments) != len(value):
        raise ScenarioError(path, f"has {len(value)} entries; must have {len(arguments)}")
    pairs = zip(arguments, value, strict=True)
    return tuple(
        _convert(argument, item, join(path, _label(item, index)))
        for index, (argument, item) in enumerate(pairs, start=1)
    )


def _label(item: Any, index: int) -> str:
    """Return the name of an entry of a list of tables, otherwise its place counted from 1."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name if isinstance(name, str) and name else str(index)


def _scalar(kind: Any, value: Any, path: str) -> Any:
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ScenarioError(path, f"expected a number, got {describe(value)}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise ScenarioError(path, f"got {value}; must be a finite number")
        return number
    expected = {bool: "true or false", int: "a whole number", str: "a text in quotes"}[kind]
    if type(value) is not kind:
        raise ScenarioError(path, f"expected {expected}, got {describe(value)}")
    return value
