"""What to say about a value that does not fit its schema."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from cosim.config.schema.old_keys import GONE, REMEDY, RENAMED, SCHEMA
from cosim.config.toml.core_schemas import Node
from cosim.config.toml.key_paths import describe, shown
from cosim.config.toml.reading import Unreadable
from cosim.config.toml.suggestions import likely_keys, unknown_key_message

UNKNOWN_KEY: Final = "unexpected_keyword_argument"
_EXPECTED: Final = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text in quotes",
    "tuple": "a list",
    "dict": "a table",
    "dataclass-args": "a table",
}
_FITTING: Final[Mapping[str, Any]] = {
    "int": int, "float": int | float, "str": str, "tuple": list, "dict": Mapping, "dataclass-args": Mapping
}  # fmt: skip


def fault_text(error: Mapping[str, Any], node: Node, value: Any) -> str:
    """Return what is wrong with a value and what is allowed.

    Args:
        error: of pydantic.
        node: of the schema, where the value is; where a key is missing or unknown, that of its table.
        value: as the file gives it.
    """
    kind = error["type"]
    if kind == "missing":
        return "is missing; it has no default"
    if kind == UNKNOWN_KEY:
        key = error["loc"][-1]
        if new := _renamed(node, key):
            return f"is called {new} since schema {SCHEMA}; {REMEDY}"
        gone = GONE.get(node["dataclass_name"], {}).get(key)
        return gone or unknown_key_message(key, tuple(keys_of(node)))
    if isinstance(value, Unreadable):
        return value.problem
    if kind == "rule":
        return str(error["ctx"]["problem"])
    if error["loc"][-1] == "schema" and value == SCHEMA - 1 and not isinstance(value, bool):
        return f"is {value}, that of older files; {REMEDY}"
    if node["type"] == "literal":
        allowed = ", ".join(f"'{c}'" if isinstance(c, str) else str(c) for c in node["expected"])
        return f"got {describe(value)}; allowed: {allowed}"
    if node["type"] == "tagged-union" and isinstance(node["discriminator"], str):
        key, allowed = node["discriminator"], ", ".join(f"'{tag}'" for tag in node["choices"])
        if not isinstance(value, Mapping):
            return f"expected a table, got {describe(value)}"
        given = describe(value[key]) if key in value else "missing"
        return f"{key} is {given}; allowed: {allowed}"
    if node["type"] == "tagged-union":
        expected = " or ".join(_EXPECTED[choice["type"]] for choice in node["choices"].values())
        return f"expected {expected}, got {describe(value)}"
    if isinstance(value, bool) or not isinstance(value, _FITTING.get(node["type"], ())):
        return f"expected {_EXPECTED[node['type']]}, got {describe(value)}"
    if node["type"] == "tuple":
        return _length_text(node, len(value), "entries")
    if node["type"] == "str":
        if kind == "string_too_long":
            return _length_text(node, len(value), "characters")
        meaning = node.get("metadata", {}).get("meaning", "a text of Unicode's characters")
        return f"{shown(value)} must be {meaning}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"got {value:g}; must be a finite number"
    return f"{value:g} is out of bounds; must be {bounds_text(node)}"


def meant_keys(node: Node, key: str) -> list[str]:
    """Return which keys of a table may be meant by one that does not exist; `node` is the table's."""
    new = _renamed(node, key)
    return [new] if new else likely_keys(key, tuple(keys_of(node)))


def _renamed(node: Node, key: str) -> str | None:
    return RENAMED.get(node["dataclass_name"], {}).get(key)


def keys_of(node: Node) -> dict[str, Node]:
    """Return the nodes of a table's keys."""
    return {entry.get("validation_alias", entry["name"]): entry["schema"] for entry in node["fields"]}


def bounds_text(node: Node) -> str:
    """Return the bounds of a number in words."""
    if node.get("ge") is not None and node["ge"] == -node.get("le", math.inf):
        return f"within {node['ge']:g} and {node['le']:g}"
    words = (("above", "gt"), ("at least", "ge"), ("below", "lt"), ("at most", "le"))
    return ", ".join(f"{word} {node[key]:g}" for word, key in words if node.get(key) is not None)


def _length_text(node: Node, length: int, of: str) -> str:
    least, most = node.get("min_length"), node.get("max_length")
    if "variadic_item_index" not in node and node["type"] == "tuple":
        return f"has {length} {of}; must have {len(node['items_schema'])}"
    if least is not None and length < least:
        return f"has {length} {of}; needs at least {least}"
    return f"has {length} {of}; at most {most} are allowed"
