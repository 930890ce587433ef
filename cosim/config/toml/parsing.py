"""Turns tables (nested dicts, as TOML gives them) into frozen dataclasses, strictly.

pydantic checks types, keys and bounds; every fault is told with the path of its key, the value, and what is
allowed. What is wrong in a table does not keep rules from being checked on the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

from pydantic_core import ValidationError

from cosim.config.toml.core_schemas import Node, definitions_of, file_schema, inner_node, validator_of
from cosim.config.toml.fault_texts import UNKNOWN_KEY, fault_text, keys_of, meant_keys
from cosim.config.toml.faults import UNKNOWN, Faults, guard
from cosim.config.toml.key_paths import join, label
from cosim.config.toml.reading import only_readable

Schema = TypeVar("Schema")


class _Place(NamedTuple):
    """Where a fault is: its path, the schema's node, the value, and the table and key that hold it."""

    path: str
    node: Node
    value: Any
    table: dict[str, Any]
    key: str


def parse(kind: type[Schema], table: Mapping[str, Any], path: str, faults: Faults) -> Schema:
    """Return the dataclass that a table describes; a field whose value is wrong holds UNKNOWN.

    Args:
        kind: a frozen dataclass whose annotations carry the constraints.
        table: as TOML gives it.
        path: of the table itself, for messages.
        faults: gets all faults of the table.
    """
    kept, validator = only_readable(table), validator_of(kind)  # type: ignore[arg-type]
    for last in (False, False, True):  # a list that is too short shows once all is right within it
        try:
            made: Schema = validator.validate_python(kept)
            break
        except ValidationError as error:
            if last:
                raise
            _mark(file_schema(kind), kept, path, _without_gaps(error), faults)  # type: ignore[arg-type]
    guard(made)
    return made


def _mark(schema: Node, kept: dict[str, Any], path: str, found: list[dict[str, Any]], faults: Faults) -> None:
    """Tell the faults that pydantic has found, and put UNKNOWN in the place of each."""
    pairs = [(item, _place(schema, kept, path, item)) for item in found]
    for item, place in pairs:
        if item["type"] == UNKNOWN_KEY:
            del place.table[place.key]
            for key in meant_keys(place.node, place.key):
                place.table.setdefault(key, UNKNOWN)
    for item, place in pairs:
        if item["type"] == "missing" and place.key in place.table:
            continue  # it is there, but misspelt or by its old name
        if item["type"] != UNKNOWN_KEY:
            place.table[place.key] = UNKNOWN
        faults.add(place.path, fault_text(item, place.node, place.value))


def with_unknown(kind: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table in which all that is not given is UNKNOWN, within its tables as well."""
    schema = file_schema(kind)
    definitions = definitions_of(schema)

    def filled(node: Node, table: Mapping[str, Any]) -> dict[str, Any]:
        keys = keys_of(node)
        made: dict[str, Any] = dict.fromkeys(keys, UNKNOWN)
        for key, value in table.items():
            inner = inner_node(keys[key], definitions) if key in keys else node
            deeper = inner["type"] == node["type"] and inner is not node and isinstance(value, dict)
            made[key] = filled(inner, value) if deeper else value
        return made

    return filled(inner_node(schema, definitions), given)


def _without_gaps(error: ValidationError) -> list[dict[str, Any]]:
    """Return what pydantic found; entries missing at the end of a list are one fault, that of the list.

    Nothing is said of a list that has a wrong entry.
    """
    found: dict[tuple[str | int, ...], dict[str, Any]] = {}
    for item in error.errors(include_url=False, include_input=False):
        place = item["loc"]
        if item["type"] == "missing" and isinstance(place[-1], int):
            place = place[:-1]
            found[place] = {"type": "too_short", "loc": place}
        else:
            found[place] = dict(item)
    for above in [place[:depth] for place in found for depth in range(1, len(place))]:
        found.pop(above, None)  # too short without the wrong entries: that follows from them
    return list(found.values())


def _place(schema: Node, kept: dict[str, Any], path: str, found: Mapping[str, Any]) -> _Place:
    """Return where a fault is; the table and key are the innermost ones that a dataclass has a field for."""
    definitions = definitions_of(schema)
    node, value = inner_node(schema, definitions), kept
    table, key = kept, ""
    for part in found["loc"]:
        if node["type"] == "tagged-union":
            node = inner_node(node["choices"][part], definitions)
            continue
        within, value = value, _item(value, part)
        path = join(path, label(value, part + 1) if isinstance(part, int) else part)
        if node["type"] == "dataclass-args":
            table, key = within, str(part)
            if found["type"] == UNKNOWN_KEY and part not in keys_of(node):
                break
            inner = keys_of(node)[key]
        elif node["type"] == "dict":
            inner = node["values_schema"]
        else:
            items = node["items_schema"]
            inner = items[int(part) if "variadic_item_index" not in node else 0]
        node = inner_node(inner, definitions)
    return _Place(path, node, value, table, key)


def _item(value: Any, part: str | int) -> Any:
    try:
        return value[part]
    except LookupError:  # a missing key
        return None
