"""Writes scenario dataclasses back as TOML, every default spelled out."""

import json
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from cosim.config.schema.scenario import GivenBodyTable, Scenario
from cosim.config.toml.keys import key_of

_HEADER = "# The scenario as it ran, every value spelled out. Run it again with: cosim run <this file>\n"
_HEADER_GIVEN = (
    "# The scenario as it ran, every value spelled out; its soft body is in no file.\n"
    "# Run it again from Python: cosim.run(<this file>, body=...)\n"
)


def to_table(value: Any) -> Any:
    """Return the nested dicts and lists that describe a schema dataclass; absent values are left out."""
    if is_dataclass(value) and not isinstance(value, type):
        entries = ((key_of(entry), getattr(value, entry.name)) for entry in fields(value))
        return {key: to_table(item) for key, item in entries if item is not None}
    if isinstance(value, tuple):
        return [to_table(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_table(item) for key, item in value.items()}
    return value


def scenario_text(scenario: Scenario) -> str:
    """Return the resolved scenario as TOML text, which loads to an equal one with the same body."""
    given = isinstance(scenario.soft_robot, GivenBodyTable)
    return (_HEADER_GIVEN if given else _HEADER) + table_text(to_table(scenario))


def table_text(table: Mapping[str, Any]) -> str:
    """Return nested tables as TOML text."""
    return "\n".join(_table_lines(table, "")) + "\n"


def _table_lines(table: Mapping[str, Any], path: str) -> list[str]:
    """Lines of one table: single values first, then its tables and lists of tables."""
    tables = {key: value for key, value in table.items() if _is_table(value) or _is_table_list(value)}
    lines = [f"{_key(key)} = {_inline(value)}" for key, value in table.items() if key not in tables]
    for key, value in tables.items():
        inner = f"{path}.{_key(key)}" if path else _key(key)
        if _is_table(value):
            lines += ["", f"[{inner}]", *_table_lines(value, inner)]
        else:
            for entry in value:
                lines += ["", f"[[{inner}]]", *_table_lines(entry, inner)]
    return lines


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_table_list(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(_is_table(entry) for entry in value)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)


def _text(text: str) -> str:
    # JSON's escapes are a subset of those of TOML's basic strings, except for the delete character
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    return repr(value)
