"""Schemas of tables as pydantic makes them of dataclasses, made strict and bounded by units."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Final, TypeAlias

from pydantic import TypeAdapter
from pydantic_core import SchemaValidator, core_schema

from cosim.config.toml.faults import UNKNOWN
from cosim.config.toml.magnitudes import magnitude_of

Node: TypeAlias = Mapping[str, Any]
"""A node of a pydantic core schema."""

_SCALARS: Final = ("bool", "int", "float", "str")
_KINDS: Final = {"tuple": "list", "dict": "table"}


@cache
def bounded_schema(kind: type) -> Node:
    """Return the schema of a dataclass, its numbers within the magnitudes of their keys' units."""
    made: Node = _bounded(TypeAdapter(kind).core_schema, "")
    return made


@cache
def file_schema(kind: type) -> Node:
    """Return the same for tables as files give them: nothing is converted, and no key is passed over.

    A field whose value is `UNKNOWN` is left so.
    """
    made: Node = _strict(bounded_schema(kind))
    return made


@cache
def validator_of(kind: type) -> SchemaValidator:
    """Return what makes a dataclass of a table."""
    return SchemaValidator(file_schema(kind))


def forget_schemas() -> None:
    """Make schemas anew when they are next asked for: the tables that they may hold have changed."""
    for kept in (bounded_schema, file_schema, validator_of):
        kept.cache_clear()


def definitions_of(schema: Node) -> dict[str, Node]:
    """Return the nodes of a schema that others refer to, by their references."""
    return {entry["ref"]: entry for entry in schema.get("definitions", ())}


def inner_node(node: Node, definitions: Mapping[str, Node]) -> Node:
    """Return a node without what is only wrapped about it: defaults, checks, references."""
    while True:
        if node["type"] == "definition-ref":
            node = definitions[node["schema_ref"]]
        elif "schema" in node:
            node = node["schema"]
        elif "steps" in node:
            node = node["steps"][-1]
        else:
            return node


def _bounded(node: Any, key: str) -> Any:
    if isinstance(node, list):
        return [_bounded(item, key) for item in node]
    if not isinstance(node, dict):
        return node
    kind = node.get("type")
    if kind == "nullable":  # TOML has no null: who leaves a value out leaves its key out
        return _bounded(node["schema"], key)
    if kind == "dataclass-field":
        key = str(node.get("validation_alias", node["name"]))
    made = {name: value if name == "default" else _bounded(value, key) for name, value in node.items()}
    if kind == "float":
        magnitude = magnitude_of(key)
        if not {"le", "lt"} & made.keys():
            made["le"] = magnitude.largest
        if not {"ge", "gt"} & made.keys():
            made["ge"] = -magnitude.largest
        if made.get("gt") == 0.0:
            made["ge"] = magnitude.smallest
        made["allow_inf_nan"] = False
    return made


def _strict(node: Any) -> Any:
    if isinstance(node, list):
        return [_strict(item) for item in node]
    if not isinstance(node, dict):
        return node
    kind = node.get("type")
    made = {name: value if name == "default" else _strict(value) for name, value in node.items()}
    if kind in _SCALARS:
        made["strict"] = True
    elif kind == "literal" and isinstance(made["expected"][0], int):  # to Python, 1 == 1.0 == True
        return core_schema.chain_schema([core_schema.int_schema(strict=True), node])
    elif kind == "union":
        choices = {_KINDS.get(choice["type"], "one"): choice for choice in made["choices"]}
        return core_schema.tagged_union_schema(choices, _fitting)
    elif kind == "dataclass-args":
        made["extra_behavior"] = "forbid"
    elif kind == "dataclass-field":
        made["schema"] = _knowing(made["schema"])
    return made


def _fitting(value: Any) -> str:
    """Return for which of several kinds of values one is meant."""
    return "list" if isinstance(value, list) else "table" if isinstance(value, Mapping) else "one"


def _knowing(schema: Any) -> Any:
    def known(value: Any, validate: Any) -> Any:
        return value if value is UNKNOWN else validate(value)

    if schema["type"] == "default":
        return {**schema, "schema": _knowing(schema["schema"])}
    return core_schema.no_info_wrap_validator_function(known, schema)
